"""Opens a page in a real Chromium without a window, and has a script work in it."""

import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None,
    reason="THE TRACE'S PAGE IS NOT TESTED: there is no Chromium here; on Debian: apt-get install chromium",
)
RESULT = re.compile(r'<pre id="result">(.*?)</pre>', re.DOTALL)


def work_in(page: Path, script: str) -> Any:
    """Return what a JavaScript function body returns when the page has been loaded.

    Args:
        page: the page; a copy of it with the script is opened.
        script: the body of a function; it runs after the page's own scripts.
    """
    assert CHROMIUM
    tested = page.with_name("tested.html")
    probe = """<script>
      addEventListener("load", () => {
        const result = document.createElement("pre");
        result.id = "result";
        try { result.textContent = JSON.stringify((() => {%s})()); }
        catch (error) { result.textContent = JSON.stringify({error: String(error.stack)}); }
        // The rest is not to be written out: it is long, and not all of it can be.
        document.body.replaceChildren(result);
      });
    </script>"""
    head, comments, rest = page.read_text().partition("<!--")
    tested.write_text(head + probe % script + comments + rest)
    profile = page.parent / "chromium-profile"
    command = [
        CHROMIUM,
        "--headless",
        "--no-sandbox",  # tests may run as root
        "--disable-gpu",
        "--disable-dev-shm-usage",
        f"--user-data-dir={profile}",
        "--window-size=1000,700",
        "--dump-dom",
        tested.as_uri(),
    ]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=100, check=True)
    found = RESULT.search(ended.stdout)
    assert found, ended.stderr[-2000:]
    return json.loads(unescape(found[1]))
