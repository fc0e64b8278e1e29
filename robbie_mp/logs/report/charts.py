"""Drawings of the report, as SVG: curves over time, the timeline, and the map with the robot's way."""

from collections.abc import Sequence
from typing import NamedTuple

from robbie_mp.attached.views.series import PlotSeries
from robbie_mp.logs.report.elements import Html, element, joined
from robbie_mp.logs.report.pictures import MapPicture
from robbie_mp.logs.report.seen import Way

WIDTH, HEIGHT = 980, 160
LEFT, RIGHT, TOP, BOTTOM = 46, 10, 8, 22
MOST_DRAWN = 600
MARGIN_M = 0.5
SMALLEST_M = 2.0


class Pin(NamedTuple):
    """A place that the map shows."""

    x_m: float
    y_m: float
    text: str
    kind: str
    """Class of its colour."""


class Stretch(NamedTuple):
    """A stretch of a row of the timeline; without length, a moment."""

    begin_s: float
    end_s: float
    text: str
    kind: str


def curve(series: PlotSeries, begin_s: float, end_s: float, unit: str, low: float, high: float) -> Html:
    """Draw a curve over the time of the run.

    Args:
        series: the values, at seconds since 1970.
        begin_s: begin of the run, seconds since 1970.
        end_s: its end.
        unit: of the values.
        low: the axis begins at this value, or below.
        high: it ends at this value, or above.
    """
    low, high = min([low, *series.values]), max([high, *series.values])
    span_s, span = max(1e-3, end_s - begin_s), (high - low) or 1.0
    stride = max(1, len(series.values) // MOST_DRAWN)
    points = " ".join(
        f"{LEFT + (time_s - begin_s) / span_s * (WIDTH - LEFT - RIGHT):.1f},"
        f"{HEIGHT - BOTTOM - (value - low) / span * (HEIGHT - TOP - BOTTOM):.1f}"
        for time_s, value in zip(series.times_s[::stride], series.values[::stride], strict=True)
    )
    lines = []
    for share in (0.0, 0.5, 1.0):
        y = HEIGHT - BOTTOM - share * (HEIGHT - TOP - BOTTOM)
        lines.append(element("line", x1=LEFT, x2=WIDTH - RIGHT, y1=f"{y:.1f}", y2=f"{y:.1f}", class_="grid"))
        label = f"{low + share * span:.3g} {unit}"
        lines.append(element("text", label, x=LEFT - 6, y=f"{y + 4:.1f}", text_anchor="end"))
    curve_line = element("polyline", points=Html(points), class_="curve")
    drawn = [*lines, *_time_axis(span_s), curve_line]
    return element(
        "svg", *drawn, viewBox=f"0 0 {WIDTH} {HEIGHT}", role="img", class_="chart", aria_label=series.name
    )


def _time_axis(span_s: float) -> list[Html]:
    step_s = next((one for one in STEPS_S if span_s / one <= 8), span_s / 8)
    made, at_s = [], 0.0
    while at_s <= span_s:
        x = LEFT + at_s / span_s * (WIDTH - LEFT - RIGHT)
        anchor = "start" if not at_s else "end" if x > WIDTH - RIGHT - 16 else "middle"
        made.append(element("text", clock(at_s), x=f"{x:.1f}", y=HEIGHT - 6, text_anchor=anchor))
        at_s += step_s
    return made


STEPS_S = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14400, 28800, 86400)


def clock(time_s: float) -> str:
    """Return a time of the run as `1:05` or `2:01:05`; before its begin with a minus."""
    minutes, seconds = divmod(int(abs(time_s)), 60)
    hours, minutes = divmod(minutes, 60)
    sign = "-" if time_s <= -1 else ""
    return f"{sign}{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{sign}{minutes}:{seconds:02d}"


def timeline(rows: Sequence[tuple[str, Sequence[Stretch]]], begin_s: float, end_s: float) -> Html:
    """Draw what happened over the time of the run, in rows of one kind each."""
    span_s, left, row_px = max(1e-3, end_s - begin_s), 110, 22
    height = row_px * len(rows) + BOTTOM

    def x(time_s: float) -> float:
        return left + min(1.0, max(0.0, (time_s - begin_s) / span_s)) * (WIDTH - left - RIGHT)

    drawn: list[Html] = []
    for at, (name, stretches) in enumerate(rows):
        y = row_px * at + row_px / 2
        drawn.append(element("line", x1=left, x2=WIDTH - RIGHT, y1=y, y2=y, class_="grid"))
        drawn.append(element("text", name[:16], x=left - 8, y=y + 4, text_anchor="end"))
        for one in stretches[:MOST_DRAWN]:
            begin, wide = x(one.begin_s), max(3.0, x(one.end_s) - x(one.begin_s))
            place = {"x": f"{begin:.1f}", "width": f"{wide:.1f}", "y": y - 7, "height": 14, "rx": 1.5}
            drawn.append(element("rect", element("title", one.text), class_=f"at-{one.kind}", **place))
    step_s = next((one for one in STEPS_S if span_s / one <= 8), span_s / 8)
    for number in range(int(span_s / step_s) + 1):
        label_x = x(begin_s + number * step_s)
        anchor = "end" if label_x > WIDTH - RIGHT - 16 else "middle"
        drawn.append(
            element("text", clock(number * step_s), x=f"{label_x:.1f}", y=height - 6, text_anchor=anchor)
        )
    return element(
        "svg",
        *drawn,
        viewBox=f"0 0 {WIDTH} {height}",
        role="img",
        class_="chart",
        aria_label="what happened when",
    )


def map_drawing(map_picture: MapPicture | None, way: Way, pins: Sequence[Pin]) -> Html:
    """Draw the map, the way of the robot and pins; without a map, the way alone."""
    shown = map_picture or _paper(way, pins)
    width, height = shown.width, shown.height
    unit = max(width, height) / 100.0
    drawn: list[object] = []
    if shown.address:
        drawn.append(
            element("image", href=Html(shown.address), width=width, height=height, preserveAspectRatio="none")
        )
    drawn += [element("polyline", points=Html(points), class_="way") for points in _pieces(way, shown)]
    for kind, place in (("begin", way.places[:1]), ("end", way.places[-1:])):
        for x_m, y_m in place:
            x, y = shown.place(x_m, y_m)
            label = element("title", f"the robot at the {kind}")
            drawn.append(
                element(
                    "circle", label, cx=f"{x:.1f}", cy=f"{y:.1f}", r=f"{1.3 * unit:.2f}", class_=f"way-{kind}"
                )
            )
    for number, pin in enumerate(pins, 1):
        x, y = shown.place(pin.x_m, pin.y_m)
        disc = element("circle", element("title", pin.text), r=f"{1.7 * unit:.2f}", class_=f"at-{pin.kind}")
        label = element(
            "text", number, y=f"{0.75 * unit:.2f}", font_size=f"{2.1 * unit:.2f}", text_anchor="middle"
        )
        drawn.append(element("g", disc, label, transform=f"translate({x:.1f} {y:.1f})", class_="pin"))
    drawn.append(_scale(shown, unit))
    return element(
        "svg",
        *drawn,
        viewBox=f"0 0 {width} {height}",
        role="img",
        class_="map",
        aria_label="map and way of the robot",
    )


def _pieces(way: Way, shown: MapPicture) -> list[str]:
    pieces: list[list[str]] = []
    for at, (x_m, y_m) in enumerate(way.places):
        if not pieces or at in way.breaks:
            pieces.append([])
        x, y = shown.place(x_m, y_m)
        pieces[-1].append(f"{x:.1f},{y:.1f}")
    return [" ".join(piece) for piece in pieces if len(piece) > 1]


def _paper(way: Way, pins: Sequence[Pin]) -> MapPicture:
    """Return an empty map that holds a way and pins."""
    places = [*way.places, *((pin.x_m, pin.y_m) for pin in pins)] or [(0.0, 0.0)]
    low_x, low_y = (min(place[axis] for place in places) - MARGIN_M for axis in (0, 1))
    high_x, high_y = (max(place[axis] for place in places) + MARGIN_M for axis in (0, 1))
    wide_m, high_m = max(SMALLEST_M, high_x - low_x), max(SMALLEST_M, high_y - low_y)
    per_pixel = max(wide_m, high_m) / 600
    return MapPicture(
        "", round(wide_m / per_pixel), round(high_m / per_pixel), per_pixel, (low_x, low_y, 0.0)
    )


def _scale(shown: MapPicture, unit: float) -> Html:
    wide_m = shown.width * shown.metres_per_pixel
    length_m = next((one for one in SCALES_M if one >= wide_m / 8), SCALES_M[-1])
    length, y = length_m / shown.metres_per_pixel, shown.height - 2 * unit
    line = element("line", x1=2 * unit, x2=f"{2 * unit + length:.1f}", y1=y, y2=y)
    label = element("text", f"{length_m:g} m", x=2 * unit, y=f"{y - unit:.1f}", font_size=f"{2.2 * unit:.2f}")
    return element("g", joined(line, label), class_="scale")


SCALES_M = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
