"""Parts that pages draw many times a second: encoded once for all pages, sent as fast as each can draw."""

from pathlib import Path

from robbie_mp.station.live.parts import LiveParts

SCRIPTS = {"robbie-live": str(Path(__file__).parent / "scripts")}
"""Import map for elements whose script uses live parts: it can `import … from "robbie-live"`."""

__all__ = ["SCRIPTS", "LiveParts"]
