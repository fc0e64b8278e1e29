"""What pages draw many times a second: encoded once for all pages, sent to each as fast as it can draw."""

from pathlib import Path

from robbie_mp.station.live.parts import LiveParts

SCRIPTS = {"robbie-live": str(Path(__file__).parent / "scripts")}
"""For elements whose script follows live parts: it may `import … from "robbie-live"`."""

__all__ = ["SCRIPTS", "LiveParts"]
