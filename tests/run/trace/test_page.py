"""The page of a trace in a real browser is fast, safe, and complete even if its writer was killed."""

import json
import shutil
import subprocess
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path

import pytest

from robbie_mp.base.visible_text import visible
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind
from robbie_mp.run.trace.page import TracePage
from tests.run.trace._support.browser import work_in
from tests.station._support.browser import needs_chromium

pytestmark = pytest.mark.slow

NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="there is no Node.js here; Chromium tests the same")
HOSTILE = visible(
    "--></script><script>window.hacked = 1</script><img src=x onerror='window.hacked = 1'><!-- &amp; \ud800"
)


def entry(number: int, text: str, module: str = "laser", kind: Kind = Kind.INFO, **more: object) -> Entry:
    incarnation = int(str(more.pop("incarnation", 1)))
    return Entry(number, 1.7e9 + number / 1000, kind, module, incarnation, "log", text, **more)  # type: ignore[arg-type]


def write_page(folder: Path, entries: list[Entry], page_bytes: int = 1 << 30) -> Path:
    page = TracePage(folder, page_bytes, pages=2)
    for begin in range(0, len(entries), 1000):
        page.write([made.to_line() for made in entries[begin : begin + 1000]])
    page.close()
    return folder / "trace.html"


@needs_chromium
def test_hundred_thousand_entries_are_filtered_in_less_than_a_second(tmp_path: Path) -> None:
    kinds, modules = list(Kind), ("laser", "mapping", "exploration")
    entries = [
        entry(number, f"scan {number} of the arena, all is well", modules[number % 3], kinds[number % 4])
        for number in range(100_000)
    ]
    found = work_in(
        write_page(tmp_path, entries),
        """
        const timed = (act) => {
          const begin = performance.now();
          act();
          const row = document.querySelector("#rows .row:last-child");
          return { ms: performance.now() - begin + (row ? 0 * row.getBoundingClientRect().top : 0),
                   count: parseInt(at("count").textContent),
                   rows: document.querySelectorAll("#rows .row").length,
                   last: row ? row.textContent : "" };
        };
        const at = (id) => document.getElementById(id);
        const type = (text) => { at("text").value = text; at("text").dispatchEvent(new Event("input")); };
        const results = {};
        results.all = timed(() => type(""));
        results.text = timed(() => type("SCAN 77"));
        results.expression = timed(() => type("/scan 9+ of/"));
        results.module = timed(() => { type(""); at("module").value = "mapping"; at("module").onchange(); });
        results.kind = timed(() => document.querySelector("input[value=info]").click());
        results.end = timed(() => { at("list").scrollTop = 1e9; at("list").onscroll(); });
        return results;
        """,
    )
    assert {name: result["count"] for name, result in found.items()} == {
        "all": 100_000,
        "text": sum("scan 77" in made.text for made in entries),
        "expression": 5,
        "module": 33_333,
        "kind": 25_000,
        "end": 25_000,
    }
    assert all(0 < result["rows"] < 100 for result in found.values()), "rows nobody sees are in the document"
    assert "scan 99997" in found["end"]["last"]
    print({name: round(result["ms"]) for name, result in found.items()})
    assert max(result["ms"] for result in found.values()) < 1000


@needs_chromium
def test_page_shows_starts_crashes_and_details_and_executes_no_content(tmp_path: Path) -> None:
    page = write_page(
        tmp_path,
        [
            entry(1, "set up"),
            entry(2, HOSTILE, kind=Kind.ERROR, logger=HOSTILE, traceback=HOSTILE),
            entry(3, "crashed", kind=Kind.ERROR, traceback="the stack", crash_report="crashes/laser-1.json"),
            entry(4, "set up again", incarnation=2),
            entry(5, "sly", crash_report="javascript:alert(1)"),
            entry(6, "hello", "mapping", Kind.SYSTEM),
        ],
    )
    with page.open("ab") as file:
        file.write(b"<!--" + entry(7, "half a line of a killed supervisor").to_line()[:-30])
    found = work_in(
        page,
        """
        const rows = () => [...document.querySelectorAll("#rows .row")];
        const links = () => [...document.querySelectorAll("#detail a")].map((a) => a.getAttribute("href"));
        const click = (text) => rows().find((row) => row.textContent.includes(text)).click();
        const texts = rows().map((row) => row.lastChild.textContent);
        click("crashed");
        const crash = { text: document.getElementById("detail").textContent, links: links() };
        click("sly");
        const sly = links();
        click("<img src=x");
        const box = document.getElementById("module");
        return { texts, crash, sly, hostile: document.getElementById("detail").textContent,
                 hacked: window.hacked, images: document.images.length,
                 count: document.getElementById("count").textContent,
                 modules: [...box.options].map((option) => option.value), hash: location.hash };
        """,
    )
    assert found["texts"][0] == "set up"
    assert found["texts"][3:] == ["start 2", "set up again", "sly", "hello"]
    assert "the stack" in found["crash"]["text"]
    assert found["crash"]["links"] == ["crashes/laser-1.json"]
    assert found["sly"] == []
    assert found["hostile"].count("window.hacked = 1") == 3 * HOSTILE.count("window.hacked = 1")
    assert (found.get("hacked"), found["images"]) == (None, 0)
    assert found["count"] == "6 shown, 1 damaged"
    assert found["modules"] == ["", "laser", "mapping"]
    assert "kinds=error+warning+info+system" in found["hash"]


@needs_node
def test_filter_finds_the_right_entries() -> None:
    """The page's logic alone, in an engine that is quick to start."""
    page = files("robbie_mp.run.trace").joinpath("page.html").read_text()
    logic = page.split("<script>")[1].split("</script>")[0]
    entries = [
        entry(1, "Scan <1>"),
        entry(2, "scan 2", "mapping", Kind.ERROR, traceback="Boom at 7"),
        entry(3, "again", incarnation=2),
        entry(4, "old", incarnation=1),
    ]
    lines = [made.to_line().decode() for made in entries]
    asked = """
      const read = readEntries([...%s, "half", "null", "7"]);
      const every = { kinds: new Set(KINDS), module: "", text: "" };
      const found = (wanted) => filterEntries(read.entries, { ...every, ...wanted }).map((one) => one.text);
      console.log(JSON.stringify({
        damaged: read.damaged, all: found({}), text: found({ text: "SCAN" }), trace: found({ text: "boom" }),
        expression: found({ text: "/^mapping.*2/" }),
        wrong: found({ text: "/(/" }), slash: found({ text: "/" }),
        module: found({ module: "laser" }), kind: found({ kinds: new Set(["error"]) }) }));
    """
    ended = subprocess.run(
        [str(NODE), "-"], input=logic + asked % json.dumps(lines), capture_output=True, text=True, check=True
    )
    assert json.loads(ended.stdout) == {
        "damaged": 3,
        "all": ["Scan <1>", "scan 2", "start 2", "again", "old"],
        "text": ["Scan <1>", "scan 2"],
        "trace": ["scan 2"],
        "expression": ["scan 2"],
        "wrong": [],
        "slash": [],
        "module": ["Scan <1>", "start 2", "again", "old"],
        "kind": ["scan 2", "start 2"],
    }


class Comments(HTMLParser):
    """What Python's own parser finds in a page."""

    def __init__(self, text: str):
        super().__init__()
        self.found: list[Entry | None] = []
        self.ended: list[str] = []
        self.feed(text)

    def handle_comment(self, data: str) -> None:
        self.found.append(Entry.from_line(data.encode()))

    def handle_endtag(self, tag: str) -> None:
        self.ended.append(tag)


def test_every_entry_is_a_comment_after_a_complete_document(tmp_path: Path) -> None:
    entries = [entry(1, HOSTILE, logger=HOSTILE), entry(2, "->-->--!>"), entry(3, "<!--")]
    text = write_page(tmp_path, entries).read_text()
    parsed = Comments(text)
    assert parsed.found == entries
    assert parsed.ended[-1] == "script"
    assert "http:" not in text
    assert "https:" not in text


def test_full_page_is_rotated_and_remains_complete(tmp_path: Path) -> None:
    entries = [entry(number, f"line {number}") for number in range(5000)]
    head = write_page(tmp_path, [entry(0, "of a former run")]).stat().st_size
    write_page(tmp_path, entries, page_bytes=head + 200_000)
    older, newer = (Comments((tmp_path / name).read_text()) for name in ("trace.1.html", "trace.html"))
    assert newer.ended == older.ended
    kept = [*older.found, *newer.found]
    assert kept == entries[-len(kept) :]
    assert len(kept) < 5000
    assert sorted(path.name for path in tmp_path.iterdir()) == ["trace.1.html", "trace.html"]


def test_entry_longer_than_a_page_creates_no_empty_pages(tmp_path: Path) -> None:
    page = TracePage(tmp_path, page_bytes=10, pages=3)
    for number in range(2):
        page.write([entry(number, "x" * 100).to_line()])
    page.close()
    pages = [Comments(path.read_text()).found for path in sorted(tmp_path.iterdir())]
    assert pages == [[entry(0, "x" * 100)], [entry(1, "x" * 100)]]


def test_page_of_an_earlier_run_is_kept(tmp_path: Path) -> None:
    write_page(tmp_path, [entry(1, "former")])
    write_page(tmp_path, [entry(2, "present")])
    assert [made and made.text for made in Comments((tmp_path / "trace.1.html").read_text()).found] == [
        "former"
    ]
    assert [made and made.text for made in Comments((tmp_path / "trace.html").read_text()).found] == [
        "present"
    ]


def test_full_disk_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = TracePage(tmp_path / "gone", 1 << 20, 2)
    page.write([entry(1, "lost").to_line()])
    assert page.dropped == 1
