"""What the module written in C offers; its sources lie beside this file.

What is declared here is listed in `Native` of `choice.py` as well.
"""

LAYOUT_VERSION: int
"""That of layout.py when the module was built."""
SOURCES: str
"""The checksum of the C sources when the module was built, see sources.py."""
