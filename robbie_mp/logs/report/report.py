"""Puts the report together."""

from __future__ import annotations

import time
from collections.abc import Iterable
from importlib.resources import files

from robbie_mp.attached.views import quantities
from robbie_mp.base.utc import time_text
from robbie_mp.base.version import installed_version
from robbie_mp.logs.black_box.happenings import Happening, HappeningKind, happenings_of
from robbie_mp.logs.recording.repair import Progress, unwatched
from robbie_mp.logs.report.charts import Pin, Stretch, clock, curve, map_drawing, timeline
from robbie_mp.logs.report.elements import Html, element, joined, picture, table, text
from robbie_mp.logs.report.failures import ModuleFailure, failures_of
from robbie_mp.logs.report.pictures import Pictures
from robbie_mp.logs.report.run_files import ModuleSummary, ReportedRun, is_time
from robbie_mp.logs.report.seen import Seen, SeenOnTheWay
from robbie_mp.run.supervisor.run import SUMMARY_FILE
from robbie_mp.run.trace.reader import LOG_FOLDER

HEAD = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>{title}</title><link rel="icon" href="data:,">
<style>
{style}</style></head><body><main>
"""
BREAK = Html("<br>")
MOST_ROWS = 200
MOST_CHANNELS = 100
MOST_CRASHES = 20
MOST_FILES = 60
MOST_PICTURES = 24
SAME_S = 1.5
"""The same text within this time is the same happening, seen in a clip and in a log."""
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".gif")
REPORT_FILE = "report.html"


def report_of(run: ReportedRun, progress: Progress = unwatched, now_s: float | None = None) -> str:
    """Return the report of a run as HTML. It reads the run's recordings, or if there are none its clips.

    Args:
        run: the run.
        progress: shows how much of a recording is read.
        now_s: seconds since 1970; None: the time of the machine.
    """
    seen = Seen()
    logs = [path for path in run.logs if path.exists()]
    if not any([seen.read(path, progress) for path in logs]):
        for clip in run.clips:
            seen.read(clip.folder, progress)
    return Report(run, seen, time.time() if now_s is None else now_s).html()


class Report:
    """One report.

    Args:
        run: the run.
        seen: what its messages say.
        now_s: seconds since 1970.
    """

    def __init__(self, run: ReportedRun, seen: Seen, now_s: float):
        self._run, self._seen, self._now_s = run, seen, now_s
        self._pictures = Pictures()
        self._failures = failures_of(run.remarks)
        of_clips = [one for one in happenings_of(run.clips) if is_time(one.time_s)]
        self._happened = merged(of_clips, seen.happened)
        self._begin_s = run.begin_s or seen.begin_s
        end_s = now_s if run.is_live else run.end_s if run.summary else max(run.end_s, seen.end_s)
        self._end_s = max(self._begin_s, end_s, *(one.time_s for one in self._happened))

    def html(self) -> str:
        """Return the whole file."""
        run = self._run
        style = files("robbie_mp.logs.report").joinpath("report.css").read_text()
        title = f"{run.profile}, {time_text(self._begin_s) if self._begin_s else run.folder.name}"
        parts = [
            self._head(),
            self._figures(),
            self._map(),
            self._found(),
            self._what_happened(),
            self._what_failed(),
            self._counters(),
            self._power(),
            self._modules(),
            self._recordings(),
            self._results(),
            self._notes(),
            self._foot(),
        ]
        return HEAD.format(title=text(title), style=style) + joined(*parts) + "</main></body></html>\n"

    # -- head --------------------------------------------------------------------------------------------

    def _state(self) -> tuple[str, str]:
        """Return how the run ended in words, and the class of its colour."""
        run = self._run
        if run.is_live:
            return "runs", "is-live"
        if run.summary is None:
            return "was killed", "is-bad"
        if run.summary.exit_code:
            return f"ended with exit code {run.summary.exit_code}", "is-bad"
        return "ended in order", ""

    def _head(self) -> Html:
        run = self._run
        words, look = self._state()
        parts = [
            f"run {run.run_id}" if run.run_id else "",
            f"on {self._seen.host}" if self._seen.host else "",
            f"{time_text(self._begin_s)} to {time_text(self._end_s)}" if self._begin_s else "",
            f"{run.summary.reason}" if run.summary else "",
        ]
        if run.is_live:
            parts.append(f"still running at {time_text(self._now_s)}: what follows is not its end")
        if run.summary is None and not run.is_live:
            parts.append("its supervisor was killed, so there is no summary")
        about = " · ".join(filter(None, parts))
        pill = element("span", words, class_=f"pill {look}".strip())
        return element("header", element("h1", run.profile), pill, element("p", about))

    def _figures(self) -> Html:
        run, seen = self._run, self._seen
        books = [book for module in _modules_of(run) for book in module.subscriptions]
        wrong = [book for book in books if not book.adds_up]
        repaired = [one for one in self._failures if one.took_s is not None]
        figures = [(clock(self._end_s - self._begin_s) if self._begin_s else "?", "duration")]
        if seen.way.travelled_m:
            figures.append((f"{seen.way.travelled_m:.1f} m", "travelled"))
        if seen.findings:
            figures.append((str(len(seen.findings)), "found"))
        if books:
            said = (
                f"messages, {len(wrong)} books do not add up"
                if wrong and not run.is_live
                else "messages delivered"
            )
            figures.append((f"{sum(book.delivered for book in books)}", said))
        figures.append((str(len(self._failures)), f"failures, {len(repaired)} recovered from"))
        figures.append(
            (str(sum(one.kind is HappeningKind.STOP for one in self._happened)), "emergency stops")
        )
        figures.append(
            (
                str(sum(one.kind in (HappeningKind.MARK, HappeningKind.VICTIM) for one in self._happened)),
                "marks",
            )
        )
        if seen.battery.values:
            figures.append((f"{seen.battery.values[-1]:.0f} %", "battery at the end"))
        return element(
            "div",
            *(element("div", element("b", value), element("span", name)) for value, name in figures),
            class_="figures",
        )

    # -- map and findings --------------------------------------------------------------------------------

    def _pins(self) -> list[Pin]:
        found = [Pin(one.x_m, one.y_m, one.name, "found") for one in self._found_list()]
        for happening in self._happened:
            place = self._seen.way.at(happening.time_s)
            if place is not None and happening.kind is not HappeningKind.VICTIM:
                found.append(Pin(*place, f"{self._clock(happening.time_s)} {happening.text}", happening.kind))
        return found[:MOST_ROWS]

    def _map(self) -> Html:
        seen = self._seen
        pins = self._pins()
        grid = None if seen.grid is None else self._pictures.of_map(seen.grid)
        if grid is None and not seen.way.places:
            return joined()
        listed = [
            element("li", dot(pin.kind), pin.text, value=number) for number, pin in enumerate(pins[:40], 1)
        ]
        legend = [
            element("p", "The blue line is the way of the robot, from the white disc to the blue one."),
            element("ol", *listed) if listed else "",
            element("p", "There is no map: the way is that of its odometry or poses.")
            if grid is None
            else "",
        ]
        drawing = map_drawing(grid, seen.way, pins)
        return section("Map and path", element("div", drawing, element("div", *legend), class_="beside"))

    def _found_list(self) -> list[SeenOnTheWay]:
        return sorted(self._seen.findings.values(), key=lambda one: one.time_s)

    def _found(self) -> Html:
        cards = [self._card(number, one) for number, one in enumerate(self._found_list()[:MOST_ROWS], 1)]
        places = [
            (topic, point.name, f"{point.pose.position.x:.2f}", f"{point.pose.position.y:.2f}")
            for topic, points in self._seen.places.items()
            for point in points.points
        ]
        views = []
        for topic, (time_s, image) in sorted(self._seen.views.items()):
            if address := self._pictures.of_message(image):
                caption = joined(element("b", topic), f" at {self._clock(time_s)}")
                views.append(
                    element("figure", picture(address, f"image of {topic}"), element("figcaption", caption))
                )
        parts: list[Html] = []
        if cards:
            parts.append(element("div", *cards, class_="found"))
        if places:
            parts += [element("h3", "Places"), table(("topic", "name", "x m", "y m"), places, MOST_ROWS, 2)]
        if views:
            parts += [element("h3", "Last image of each camera"), element("div", *views, class_="found")]
        return section("What was found", *parts) if parts else joined()

    def _card(self, number: int, one: SeenOnTheWay) -> Html:
        address = self._pictures.of_message(one.image) if one.image is not None else ""
        shown = picture(address, f"picture of {one.name}") if address else ""
        details = ", ".join(f"{name} {value}" for name, value in one.details.items())
        caption = [
            element("b", f"{number}  {one.name}"),
            BREAK,
            f"at {one.x_m:.2f}, {one.y_m:.2f} m, first seen at {self._clock(one.time_s)}",
            BREAK,
            element("span", details, class_="quiet"),
        ]
        return element("figure", shown, element("figcaption", *caption))

    # -- what happened -----------------------------------------------------------------------------------

    def _clock(self, time_s: float) -> str:
        return clock(time_s - self._begin_s) if self._begin_s else time_text(time_s)

    def _what_happened(self) -> Html:
        rows: dict[str, list[Stretch]] = {}
        for one in self._happened:
            rows.setdefault(one.kind, []).append(
                Stretch(one.time_s, one.time_s, f"{self._clock(one.time_s)} {one.text}", one.kind)
            )
        for failure in self._failures:
            end_s = self._end_s if failure.recovered_s is None else failure.recovered_s
            stretch = Stretch(failure.time_s, end_s, f"{failure.module}: {failure.reason}", "down")
            rows.setdefault(failure.module, []).append(stretch)
        cells: list[tuple[object, ...]] = [
            (
                self._clock(one.time_s),
                joined(dot(one.kind), one.kind),
                one.text,
                one.clip or element("span", "-", class_="quiet"),
            )
            for one in self._happened
        ]
        if not rows:
            return section(
                "What happened", element("p", "Nothing that the black box would keep.", class_="quiet")
            )
        drawing = timeline(list(rows.items())[:24], self._begin_s, self._end_s)
        more = self._seen.more_happened
        foot = element("p", f"and {more} more, which are not listed", class_="quiet") if more else ""
        listed = table(("time", "kind", "what", "clip"), cells, MOST_ROWS) if cells else ""
        return section("What happened", drawing, listed, foot, is_long=True)

    def _what_failed(self) -> Html:
        run = self._run
        if not self._failures and not run.crashes:
            return section(
                "What failed", element("p", "Nothing: no process ended as it should not.", class_="good")
            )
        cells = [self._failure_cells(one) for one in self._failures]
        restarts = sum(module.restarts for module in run.modules)
        listed = table(("time", "module", "why", "times", "recovered after"), cells, MOST_ROWS, 2)
        reports = [
            element(
                "details",
                element("summary", f"{crash.module} at {self._clock(crash.time_s)}: {crash.reason}"),
                element("pre", text("\n".join(crash.lines()), 20_000)),
            )
            for crash in run.crashes[-MOST_CRASHES:]
        ]
        told = sum(one.times for one in self._failures)
        note = (
            element(
                "p",
                f"Modules were restarted {restarts} times; the trace has kept {told} of their ends.",
                class_="quiet",
            )
            if restarts > told
            else ""
        )
        return section("What failed", listed, note, *reports, is_long=True)

    def _failure_cells(self, one: ModuleFailure) -> tuple[object, ...]:
        took = element("span", f"not: {one.outcome}", class_="bad")
        if one.took_s is not None:
            took = element("span", quantities.seconds(one.took_s), class_="good")
        return self._clock(one.time_s), one.module, one.reason, one.times, took

    # -- figures -----------------------------------------------------------------------------------------

    def _counters(self) -> Html:
        run = self._run
        modules = [one for one in _modules_of(run) if one.subscriptions]
        if not modules:
            return joined()
        cells = [self._book_cells(one) for one in modules]
        headings = (
            "module",
            "sent to it",
            "handled",
            "replaced",
            "dropped",
            "left",
            "lost",
            "waiting",
            "sum",
        )
        totals = [sum(row[at] for row in map(_sums, modules)) for at in range(len(COLUMNS))]
        routed, rest = totals[0], sum(totals[1:])
        if routed == rest:
            verdict = element(
                "p",
                f"Every message is accounted for: {routed} = {' + '.join(map(str, totals[1:]))} (handled, "
                "replaced by newer ones, dropped, left when their module stopped, lost in crashes, waiting).",
                class_="good",
            )
        else:
            why = (
                " The run goes on: what was counted between two readings is in one column only."
                if run.is_live
                else ""
            )
            verdict = element(
                "p",
                f"{routed} messages were sent to modules, and {rest} are accounted for.{why}",
                class_="bad",
            )
        published = sum(one.published for one in run.modules)
        refused = [
            f"{one.name}: {one.refused} refused for lack of room" for one in run.modules if one.refused
        ]
        refused += [
            f"{one.name}: {one.ill_formed} ill-formed ones refused" for one in run.modules if one.ill_formed
        ]
        said = element("p", f"{published} messages were published. {'; '.join(refused)}", class_="quiet")
        return section("Counters", verdict, table(headings, cells, MOST_ROWS, 8), said, is_long=True)

    def _book_cells(self, one: ModuleSummary) -> tuple[object, ...]:
        sums = _sums(one)
        is_right = sums[0] == sum(sums[1:])
        mark = element(
            "span", "✓" if is_right else f"≠ {sum(sums[1:])}", class_="good" if is_right else "bad"
        )
        shown = [
            element("span", value, class_="bad") if value and name in ("dropped", "lost") else value
            for name, value in zip(COLUMNS, sums, strict=True)
        ]
        return (one.name, *shown, mark)

    def _power(self) -> Html:
        seen, run = self._seen, self._run
        begin_s, end_s = self._begin_s, self._end_s
        parts: list[object] = []
        if seen.battery.values:
            parts += [
                element("h3", "Charge of the battery"),
                curve(seen.battery, begin_s, end_s, "%", 0.0, 100.0),
            ]
        if seen.voltage.values:
            low = min(seen.voltage.values)
            parts += [
                element("h3", "Voltage of the battery"),
                curve(seen.voltage, begin_s, end_s, "V", low, low + 0.5),
            ]
        if seen.processors.values:
            parts += [element("h3", "Processors"), curve(seen.processors, begin_s, end_s, "%", 0.0, 100.0)]
        total_s = sum(one.cpu_s for one in run.modules)
        if total_s:
            duration_s = max(1e-3, end_s - begin_s)
            used = sorted(run.modules, key=lambda one: -one.cpu_s)
            cells = [
                (one.name, f"{one.cpu_s:.1f}", f"{100 * one.cpu_s / duration_s:.1f}")
                for one in used
                if one.cpu_s
            ]
            of_one = 100 * total_s / duration_s
            parts += [
                element("h3", f"Processor time: {total_s:.1f} s, on average {of_one:.0f} % of one processor"),
                table(("process", "s", "% of one"), cells, MOST_ROWS, 2),
            ]
        return section("Battery and processors", *parts, is_long=True) if parts else joined()

    def _modules(self) -> Html:
        modules = self._run.modules[1:]
        if not modules:
            return joined()
        degraded = self._run.summary.degraded if self._run.summary else {}
        cells: list[tuple[object, ...]] = [
            (
                one.name,
                element("span", one.state, class_="bad" if one.state in ("FAILED", "BACKOFF") else None),
                one.health or degraded.get(one.name, "") or one.status or one.reason,
                one.restarts,
                one.published,
                one.handled,
            )
            for one in modules
        ]
        headings = ("module", "state", "what it said last", "restarts", "published", "handled")
        return section("Modules", table(headings, cells, MOST_ROWS, 3), is_long=True)

    def _recordings(self) -> Html:
        parts: list[object] = []
        for info in self._seen.infos if self._run.logs else []:
            counted = [one for one in info.channels if one.dropped is not None]
            dropped = sum(one.dropped or 0 for one in counted)
            state = "; ".join(info.damage) or ("is being written" if info.is_being_written else "complete")
            about = (
                f"{info.messages} messages, {quantities.size(info.bytes)}, {info.duration_s:.1f} s, "
                f"{dropped} dropped; {state}"
            )
            cells = [
                (
                    one.channel.topic or "-",
                    one.channel.type_name,
                    one.channel.sender,
                    one.messages,
                    one.dropped or 0,
                )
                for one in sorted(info.channels, key=lambda one: -one.messages)
            ]
            listed = table(("topic", "type", "sender", "messages", "dropped"), cells, MOST_CHANNELS, 2)
            parts += [
                element("h3", info.path),
                element("p", about),
                element("details", element("summary", "channels"), listed),
            ]
        for clip in self._run.clips:
            about = "; ".join(clip.about.triggers) if clip.about else "not described"
            missing = f" ({clip.about.missing})" if clip.about and clip.about.missing else ""
            parts.append(
                element(
                    "li", element("b", clip.folder.name), f" {quantities.size(clip.bytes)}: {about}{missing}"
                )
            )
        if not parts:
            return joined()
        clips = [one for one in parts if isinstance(one, Html) and one.startswith("<li")]
        others = [one for one in parts if one not in clips]
        listed_clips = [element("h3", "Clips of the black box"), element("ul", *clips)] if clips else []
        return section("Recordings", *others, *listed_clips, is_long=True)

    def _results(self) -> Html:
        """Return the files in the folder for results, and those of them that are pictures."""
        own = (LOG_FOLDER, SUMMARY_FILE, REPORT_FILE, "clips")
        try:
            found = sorted(path for path in self._run.folder.iterdir() if path.name not in own)
        except OSError:
            return joined()
        if not found:
            return joined()
        cards = []
        for path in [one for one in found if one.suffix.lower() in PICTURE_SUFFIXES][:MOST_PICTURES]:
            if address := self._pictures.of_file(path):
                cards.append(element("figure", picture(address, path.name), element("figcaption", path.name)))
        items = [
            element("li", one.name, "/" if one.is_dir() else f" ({_size(one)})") for one in found[:MOST_FILES]
        ]
        more = (
            element("p", f"and {len(found) - MOST_FILES} more", class_="quiet")
            if len(found) > MOST_FILES
            else ""
        )
        return section(
            "Results", element("div", *cards, class_="found") if cards else "", element("ul", *items), more
        )

    def _notes(self) -> Html:
        seen = self._seen
        notes = [*self._run.notes, *seen.notes]
        if not seen.infos:
            notes.append("No messages were recorded, so there is no map, path or battery.")
        elif not self._run.logs:
            notes.append(
                "There is no recording of the whole run: map, path and battery are those of the clips."
            )
        if seen.skipped:
            notes.append(f"{seen.skipped} messages could not be read.")
        if seen.images_left_out:
            notes.append(f"{seen.images_left_out} pictures of what was found are left out for lack of room.")
        notes += [f"{count} pictures are left out: {why}." for why, count in self._pictures.left_out.items()]
        errors = [one for one in self._run.remarks if one.kind == "error"]
        cells = [(self._clock(one.time_s), one.module, one.text) for one in errors]
        listed = [element("li", note) for note in notes]
        parts: list[object] = [element("ul", *listed)] if listed else []
        if cells:
            summary = element("summary", f"{len(cells)} errors in the trace")
            parts.append(element("details", summary, table(("time", "process", "error"), cells, MOST_ROWS)))
        return section("Notes", *parts, is_long=True) if parts else joined()

    def _foot(self) -> Html:
        made = f"Made {time_text(self._now_s)} by robbie-mp {installed_version()} from {self._run.folder}"
        return element("footer", made)


def section(title: str, *parts: object, is_long: bool = False) -> Html:
    """Return a section; a long one may be broken between printed pages."""
    return element("section", element("h2", title), *parts, class_="long" if is_long else None)


def dot(kind: str) -> Html:
    """Return a dot in the colour of a kind."""
    return element(
        "svg",
        element("rect", width=10, height=10, class_=f"at-{kind}"),
        viewBox="0 0 10 10",
        class_="dot",
        aria_hidden="true",
    )


def merged(of_clips: Iterable[Happening], of_logs: Iterable[Happening]) -> list[Happening]:
    """Return what happened by time, each once: a recording has what clips have, but knows no clip."""
    found = [*of_clips]
    for one in of_logs:
        is_known = any(other.text == one.text and abs(other.time_s - one.time_s) < SAME_S for other in found)
        if not is_known:
            found.append(one)
    return sorted(found, key=lambda one: one.time_s)


COLUMNS = ("routed", "delivered", "replaced", "dropped", "left", "lost", "waiting")
"""What was sent to a module, and what became of it: the rest adds up to the first."""


def _modules_of(run: ReportedRun) -> list[ModuleSummary]:
    """Return the figures of the modules, without those of supervisor and core."""
    return run.modules[1:-1]


def _sums(module: ModuleSummary) -> list[int]:
    """Return the sums of the columns over all subscriptions; what was left does not count as dropped here."""
    sums = {name: sum(getattr(book, name) for book in module.subscriptions) for name in COLUMNS}
    sums["dropped"] -= sums["left"]
    return list(sums.values())


def _size(path: object) -> str:
    try:
        return quantities.size(path.stat().st_size)  # type: ignore[attr-defined]
    except OSError:
        return "?"
