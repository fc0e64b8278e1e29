"""The trace as a web page that needs no network and no server.

The page is `page.html` followed by one HTML comment for each entry; the script in the page reads these.
HTML allows the end tags of body and document to be omitted. So the file is a complete, valid page after every
write, even if the writer is killed: nothing at its end must be moved or closed. A page that reaches its size
limit is renamed to `trace.1.html`, and a new page begins.
"""

from importlib.resources import files
from pathlib import Path

from robbie_mp.run.trace.rotating_file import RotatingFile

PAGE_NAME = "trace.html"


class TracePage:
    """Appends entries to the page of a run.

    Attributes:
        dropped: number of entries that the disk refused.
    """

    def __init__(self, folder: Path, page_bytes: int, pages: int, *, begin_anew: bool = True):
        """Begin a new page by default; an earlier run's page is kept as an older one.

        Args:
            folder: the folder of the trace.
            page_bytes: maximum size of each page.
            pages: how many pages are kept.
            begin_anew: False: continue the existing page.
        """
        head = files("robbie_mp.run.trace").joinpath("page.html").read_bytes()
        self._file = RotatingFile(folder / PAGE_NAME, page_bytes, pages, head)
        if begin_anew:
            self._file.begin_anew()
        self.dropped = 0

    def write(self, lines: list[bytes]) -> None:
        """Append entries from `Entry.to_line`: they hold no < and >, so none can end its comment."""
        try:
            self._file.write(b"".join([b"<!--" + line + b"-->" for line in lines]))
        except OSError:
            self.dropped += len(lines)

    def close(self) -> None:
        """Close the file; the page stays valid."""
        self._file.close()
