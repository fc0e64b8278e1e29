"""The trace as a web page that needs no network and no server.

The page is `page.html` and then one comment of HTML for each entry, appended as things happen; the script in
it reads the comments. HTML lets the end tags of body and document be left out. So the file is a whole, valid
page after every write, whoever is killed when: there is nothing at its end that would have to be moved or
closed. A page that has reached its bound becomes `trace.1.html`, and a new one begins.
"""

from importlib.resources import files
from pathlib import Path

from robbie_mp.trace.rotating_file import RotatingFile

PAGE_NAME = "trace.html"


class TracePage:
    """Appends entries to the page of a run.

    Attributes:
        dropped: entries that the disk refused.
    """

    def __init__(self, folder: Path, page_bytes: int, pages: int, *, begin_anew: bool = True):
        """Begin a new page, unless told otherwise; a former run's is kept as an older one.

        Args:
            folder: of the trace.
            page_bytes: bound of each page.
            pages: how many are kept.
            begin_anew: False: go on with the page that is there.
        """
        head = files("robbie_mp.trace").joinpath("page.html").read_bytes()
        self._file = RotatingFile(folder / PAGE_NAME, page_bytes, pages, head)
        if begin_anew:
            self._file.begin_anew()
        self.dropped = 0

    def write(self, lines: list[bytes]) -> None:
        """Append entries as `Entry.to_line` makes them: without < and >, so that none ends its comment."""
        if not self._file.write(b"".join([b"<!--" + line + b"-->" for line in lines])):
            self.dropped += len(lines)

    def close(self) -> None:
        """Close the file; the page is as whole as it was."""
        self._file.close()
