"""`robbie plot TOPIC.FIELD…`: numbers of messages over time, live in the terminal or from a recording."""

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from robbie_mp.attached.tool.message_stream import MessageStream
from robbie_mp.attached.tool.tool import RunEnded
from robbie_mp.attached.views.known_channels import channels_of_run
from robbie_mp.attached.views.known_types import types_of_run
from robbie_mp.attached.views.series import PlotSeries, number_field, splits
from robbie_mp.base.balance import Balance
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.problem import refuse
from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.cli import completers
from robbie_mp.cli.amounts import time_between
from robbie_mp.cli.channel_choice import NoSuchMessages, choose_channel
from robbie_mp.cli.log_files import add_limit_argument, print_balance, progress_bar
from robbie_mp.cli.output import console
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.logs.recording.decoding import logged_type
from robbie_mp.logs.recording.reader import Log, LogChannel, open_log
from robbie_mp.messages import DecodeError, Message
from robbie_mp.messages.descriptions import KnownTypes, TypeDescription
from robbie_mp.run.run_directory import KnownRun

FRAME_S = 0.2
WINDOW_S, ONCE_S = 30.0, 1.0
"""The time that is shown, live and with --once, unless the user says it."""
COLOURS = ["cyan", "orange", "green", "magenta", "red", "blue"]
ADVICE = "`pip install matplotlib 'plotext<6'`"
WIDTH, HEIGHT = 100, 30
"""Of a chart that is printed, in characters, and of a picture, in tenths of an inch."""


class NoPlotter(RobbieError, ImportError):
    """The library that draws is not installed.

    Example scenarios:
      - a robot's image was made without the extra `plot`
    """


@dataclass(frozen=True)
class Curve:
    """What is drawn: a field of the messages on a channel."""

    channel: ChannelName
    path: str
    read: Callable[[bytes], float | None]
    series: PlotSeries

    def add(self, time_s: float, data: bytes) -> None:
        """Add the value of a message, if it has one."""
        value = self.read(data)
        if value is not None:
            self.series.add(time_s, float(value))


def add_parser(subparsers: Commands) -> None:
    """Add `plot` to the commands."""
    parser = add_command(
        subparsers,
        "plot",
        "draw numbers of messages over time",
        "Draw fields of messages live in the terminal, until Ctrl-C; or those of a recording, in the "
        "terminal or as a PNG picture. A field is named with its topic or type: odom.pose.pose.position.x.",
        [
            "robbie plot odom.twist.twist.linear.x odom.twist.twist.angular.z",
            "robbie plot 'laser/front.ranges[180]' --window 1min",
            "robbie plot Odometry.pose.pose.position.x --recording monday -o x.png",
        ],
    )
    fields = parser.add_argument("fields", metavar="TOPIC.FIELD", nargs="+", help="what to draw")
    fields.completer = completers.published_topics  # type: ignore[attr-defined]
    parser.add_argument(
        "--window",
        metavar="TIME",
        type=time_between(1, 3600),
        help="time that is shown (30s; with --once: 1s)",
    )
    parser.add_argument("--once", action="store_true", help="print the chart after one window, and exit")
    recording = parser.add_argument(
        "--recording", metavar="RECORDING", type=Path, help="draw all of a recording in place of a run"
    )
    recording.completer = completers.logs  # type: ignore[attr-defined]
    parser.add_argument("-o", "--output", metavar="PNG", type=Path, help="with --recording: write a picture")
    add_limit_argument(parser)
    add_run_argument(parser)
    parser.set_defaults(command=plot)


def plot(arguments: argparse.Namespace) -> int:
    """Draw."""
    if arguments.recording is not None:
        return _plot_recording(arguments)
    if arguments.output is not None:
        raise refuse("-o needs --recording: `robbie record` makes one")
    if not (arguments.once or sys.stdout.isatty()):
        raise refuse("robbie plot needs a terminal; use --once, or --recording with -o")
    if arguments.window is None:
        arguments.window = ONCE_S if arguments.once else WINDOW_S
    return _plot_run(choose_run(arguments.run), arguments)


def find_curve(name: str, types: KnownTypes, channels: Sequence[ChannelName]) -> Curve:
    """Return the curve that is meant by a name such as `odom.pose.pose.position.x`.

    Raises:
        NoSuchMessages: no topic and no type is called so.
        NoSuchField: its messages have no such field.
        NotANumber: the field is no number.
    """
    problem: RobbieError = NoSuchMessages(
        f"{name!r} names no field; expected TOPIC.FIELD, such as odom.pose.x"
    )
    for number, (messages, path) in enumerate(splits(name)):
        try:
            channel = choose_channel(messages, "", types, channels)
        except NoSuchMessages as error:
            problem = problem if number else error
            continue
        message_type = types.get(channel.type_name, channel.version)
        read = _reader(message_type, number_field(message_type, path))
        return Curve(channel, path, read, PlotSeries(name))
    raise problem


def _plot_run(run: KnownRun, arguments: argparse.Namespace) -> int:
    types, channels = types_of_run(run), list(channels_of_run(run))
    curves = [find_curve(name, types, channels) for name in arguments.fields]
    draw, series = _terminal_chart(), [curve.series for curve in curves]
    wanted = list(dict.fromkeys(curve.channel for curve in curves))
    with closing(MessageStream(run, wanted, "robbie plot")) as stream:
        frames = _frames(stream, curves, arguments)
        if arguments.once:
            *_, now_s = frames
            _print(draw(series, WIDTH, HEIGHT, _shown(now_s, arguments.window)))
            print(f"({arguments.window:g} s; --window TIME for another time)", file=sys.stderr)
            return 0
        os.nice(10)  # drawing takes processor time, and the robot comes first
        with _screen() as show:
            for now_s in frames:
                show(draw(series, *console().size, _shown(now_s, arguments.window)))
    print("(the run has ended)", file=sys.stderr)
    return 0


def _shown(now_s: float, window_s: float) -> tuple[float, float]:
    """Return the times at the ends of the chart."""
    return max(0.0, now_s - window_s), max(window_s, now_s)


def _frames(stream: MessageStream, curves: Sequence[Curve], arguments: argparse.Namespace) -> Iterator[float]:
    """Take messages; yield the time in s since the beginning whenever the chart shall be drawn."""
    began_s = time.monotonic()
    next_s = FRAME_S
    while True:
        try:
            received = stream.receive()
        except RunEnded:
            yield time.monotonic() - began_s
            return
        now_s = time.monotonic() - began_s
        if received is not None:
            of = ChannelName(received.type_name, received.version, received.topic)
            for curve in (one for one in curves if one.channel.takes(of)):
                curve.add(received.published_ns / 1e9 - began_s, received.data)
        if now_s >= next_s:
            for curve in curves:
                curve.series.forget_before(now_s - arguments.window)
            next_s = now_s + FRAME_S
            yield now_s
        if arguments.once and now_s >= arguments.window:
            yield now_s
            return


@contextmanager
def _screen() -> Iterator[Callable[[str], None]]:
    """Yield the function that shows a chart on the terminal's other screen."""
    from rich.live import Live  # noqa: PLC0415 - help is waited for
    from rich.text import Text  # noqa: PLC0415

    with Live(console=console(), screen=True, auto_refresh=False) as live:
        yield lambda chart: live.update(Text.from_ansi(chart), refresh=True)


def _print(chart: str) -> None:
    from rich.text import Text  # noqa: PLC0415

    console().print(Text.from_ansi(chart), soft_wrap=True)


def _plot_recording(arguments: argparse.Namespace) -> int:
    balance = Balance()
    with open_log(arguments.recording, arguments.limits) as log:
        types = KnownTypes(
            TypeDescription(one.type_name, one.version, one.schema) for one in log.channels if one.schema
        )
        channels = [ChannelName(one.type_name, one.version, one.topic) for one in log.channels]
        curves = [find_curve(name, types, channels) for name in arguments.fields]
        finish = _picture(arguments.output) if arguments.output else _chart()
        for curve in curves:
            _read(log, curve, balance)
        log.count_damage(balance)
    finish([curve.series for curve in curves])
    return print_balance(arguments.output or arguments.recording, balance, file=sys.stderr)


def _read(log: Log, curve: Curve, balance: Balance) -> None:
    """Add the values of a recording, of each channel with the fields that its type had then."""
    readers = dict(_readers(log, curve, balance))
    total = sum(log.counts[channel] for channel in readers)
    with progress_bar(f"reading {curve.series.name}") as progress:
        for done, logged in enumerate(log.messages(channels=readers), start=1):
            progress(done, total)
            try:
                value = readers[logged.channel](logged.data)
            except DecodeError:
                balance.leave_out("messages that do not encode their type")
                continue
            if value is None:
                balance.leave_out(f"messages without {curve.path}")
                continue
            curve.series.add((logged.time_ns - log.start_ns) / 1e9, float(value))
            balance.use()


def _readers(
    log: Log, curve: Curve, balance: Balance
) -> Iterator[tuple[LogChannel, Callable[[bytes], float | None]]]:
    """Yield the channels of a recording that a curve shows, each with what reads its messages."""
    wanted = curve.channel
    for channel in log.channels:
        if channel.type_name != wanted.type_name or wanted.topic not in ("", channel.topic):
            continue
        try:
            message_type = logged_type(channel)
            number_of = number_field(message_type, curve.path)
        except RobbieError as error:
            balance.leave_out(str(error), log.counts[channel])
        else:
            yield channel, _reader(message_type, number_of)


def _reader(
    message_type: type[Message], number_of: Callable[[Message], float | None]
) -> Callable[[bytes], float | None]:
    return lambda data: number_of(message_type.decode(data))


def _chart() -> Callable[[Sequence[PlotSeries]], None]:
    """Return the function that prints series as a chart."""
    draw = _terminal_chart()

    def finish(series: Sequence[PlotSeries]) -> None:
        width = console().size.width if sys.stdout.isatty() else WIDTH
        _print(draw(series, width, HEIGHT))

    return finish


def _picture(path: Path) -> Callable[[Sequence[PlotSeries]], None]:
    """Return the function that writes series as a picture to a new file."""
    try:
        from matplotlib.figure import Figure  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise NoPlotter(f"a picture needs the library matplotlib ({error}): {ADVICE}") from error

    def finish(series: Sequence[PlotSeries]) -> None:
        figure = Figure(figsize=(WIDTH / 10, HEIGHT / 5), layout="tight")
        axes = figure.add_subplot(xlabel="time since the beginning (s)")
        axes.grid(visible=True, alpha=0.3)
        lines = [axes.plot(one.times_s, one.values, linewidth=1)[0] for one in series]
        for text in axes.legend(lines, [one_line(one.name) for one in series]).get_texts():
            text.set_parse_math(False)
        try:
            with path.open("xb") as file:
                figure.savefig(file, format="png", dpi=120)
        except OSError as error:
            raise refuse(f"{path} cannot be written: {error.strerror}") from error

    return finish


def _terminal_chart() -> Callable[..., str]:
    """Return the function that draws series as text; see `draw`."""
    try:
        import plotext  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise NoPlotter(f"robbie plot needs the library plotext ({error}): {ADVICE}") from error

    def draw(
        series: Sequence[PlotSeries], width: int, height: int, shown_s: tuple[float, float] | None = None
    ) -> str:
        plotext.clear_figure()
        plotext.plotsize(width, height)
        plotext.theme("clear")
        plotext.xlabel("s")
        if shown_s is not None:
            plotext.xlim(*shown_s)
        for one, colour in zip(series, COLOURS * len(series), strict=False):
            if one.values:
                label = f"{one_line(one.name)}  {one.values[-1]:.6g}"
                plotext.plot(one.times_s, one.values, label=label, color=colour, marker="braille")
        if not any(one.values for one in series):
            plotext.title("no values yet")
        return str(plotext.build())

    return draw
