"""Playback: plays a log into a run in place of the recorded modules, and drives the run's clock."""

import json
import math
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

from robbie_mp.base.balance import Balance
from robbie_mp.bus.observe.unhandled import UnhandledMessages
from robbie_mp.logs.playback import selection
from robbie_mp.logs.playback.log_time import LATEST_NS, LogTime
from robbie_mp.logs.playback.outlet import LockstepOutlet, PacedOutlet
from robbie_mp.logs.playback.player import Outlet, PlaybackRefused, Player
from robbie_mp.logs.playback.tape import Tape
from robbie_mp.logs.playback.time_left import TimeLeft
from robbie_mp.logs.playback.translation import RunTypes, Translation, translation_of
from robbie_mp.logs.recording.errors import LogError
from robbie_mp.logs.recording.limits import MEGABYTE, READ_LIMITS, ReadLimits
from robbie_mp.logs.recording.reader import Log, LogChannel, channel_name, open_log
from robbie_mp.logs.recording.time_jumps import LONGEST_GAP_S
from robbie_mp.messages import MessageError, PlaybackControl, PlaybackState, Time, VersionError
from robbie_mp.messages.descriptions import TypeDescription, own_types
from robbie_mp.module.module import setting
from robbie_mp.module.settings import REQUIRED, SettingError
from robbie_mp.run.lockstep import ClockSource
from robbie_mp.run.plan import CORE, RunPlan
from robbie_mp.run.run_clock import MAX_RATE, ClockWriter
from robbie_mp.run.run_directory import list_runs

TELL_EVERY_NS = 200_000_000
BALANCE_FILE = "playback.json"
"""Result of a playback: the numbers of messages that were published, and that were left out, by reason."""
SUPERVISOR = "supervisor"


class Playback(ClockSource):
    """Publishes the messages of a log unchanged: type, version, topic, order, and the time between them.

    The run's clock is the log's: set `clock: {source: playback}` in the profile if the module is named
    `playback`. The clock stops while playback is paused, or while it waits because too many messages are in
    flight. So no message is lost, however slow the machine is. With `clock.lockstep`, each message waits
    until everything that the previous one caused has finished.

    Messages of an older version are upgraded to the run's class. Messages that cannot be read, and topics of
    other programs whose type does not fit, are left out and counted. The module ends when the log has ended
    and the last message was handled. If it is killed, it continues where it was; the message that it was
    publishing at that moment may be lost.
    """

    file: Path = setting(REQUIRED, "the log: an MCAP file, or a folder with its parts", must_exist=True)
    rate: float | None = setting(
        None,
        "speed as a multiple of real time; null: as fast as possible without loss",
        minimum=1e-3,
        maximum=MAX_RATE,
    )
    start_s: float = setting(0.0, "start of the played part, s after the log's beginning", minimum=0.0)
    end_s: float | None = setting(
        None,
        "end of the played part, s after the log's beginning; null: the log's end",
        minimum=0.0,
    )
    longest_gap_s: float | None = setting(
        LONGEST_GAP_S,
        "where the log's time jumps farther, forwards or backwards, the run's clock jumps too; null: never",
        minimum=0.0,
    )
    strict: bool = setting(False, "refuse a log of which something would be left out; end at the first loss")
    loop: bool = setting(False, "start again at the end")
    paused: bool = setting(False, "wait for a command to play")
    topics: list[str] = setting(
        [], "patterns of the topics to play; without a topic, the type's last part counts; empty: all"
    )
    senders: list[str] | None = setting(
        None, "shell patterns of the modules whose messages to play; null: all that are not in this run"
    )
    max_chunk_bytes: int = setting(
        READ_LIMITS.chunk_bytes, "maximum size of a decompressed chunk of the log", minimum=MEGABYTE
    )
    outstanding_limit: int = setting(
        200, "maximum number of messages that wait or are being handled", minimum=1, maximum=4000
    )
    outstanding_bytes: int = setting(32 << 20, "maximum total size of these messages", minimum=1)
    period_s: float = setting(0.005, "time between checks of the clock", minimum=0.001)
    follows_run_clock = False
    ticks_wait = True  # for those who handle the messages

    @classmethod
    def check(cls, settings: dict[str, Any]) -> None:
        """Check that the log exists and contains messages to play."""
        with _open(settings) as log:
            length_s = (log.end_ns - log.start_ns) / 1e9
            start_s, end_s = settings["start_s"], settings["end_s"]
            if start_s > length_s:
                raise SettingError(
                    f"start_s is {start_s:g}, but {log.path} has only {length_s:g} s", "start_s"
                )
            if end_s is not None and end_s < start_s:
                raise SettingError(f"end_s is {end_s:g}, which is before start_s ({start_s:g})", "end_s")
            if not selection.of_topics(log.channels, settings["topics"]):
                names = ", ".join(sorted(set(map(channel_name, log.channels)))) or "nothing"
                wanted = f"matches {', '.join(settings['topics'])}" if settings["topics"] else "can be played"
                raise SettingError(f"{log.path} has no channel that {wanted}; it has {names}", "topics")

    @classmethod
    def further_types(cls, settings: dict[str, Any], others: Collection[str]) -> Iterable[TypeDescription]:
        """Describe the types that only the log knows; check that the others can be upgraded."""
        types = RunTypes(own_types())
        with _open(settings) as log:
            channels = selection.of_topics(log.channels, settings["topics"])
            played = selection.of_senders(channels, settings["senders"], {SUPERVISOR, CORE, *others})
            unplayable = selection.unplayable(log.channels, settings["topics"])
            translations = _translations([*played, *unplayable], types)
            if settings["strict"]:
                _refuse_loss(log, translations)
            return [
                TypeDescription(channel.type_name, channel.version, channel.schema)
                for channel in played
                if not isinstance(translations[channel.id], str)
                and types.describe(channel.type_name) is None
                and channel.schema is not None
            ]

    def setup(self) -> None:
        """Open the log, and start the run's time or continue where a killed incarnation stopped."""
        plan = self._plan()
        self.log_file = _open({"file": self.file, "max_chunk_bytes": self.max_chunk_bytes})
        self.clock_writer = ClockWriter.attach(self.run_id)
        self.unhandled = UnhandledMessages(self.run_id, self.name)
        channels = self._channels({SUPERVISOR, CORE, *(module.name for module in plan.modules)})
        types = RunTypes(TypeDescription(*one) for one in plan.types)
        outlet = self._make_outlet(_translations(channels, types))
        if self.restored:
            _count(outlet.balance, self.restored["balance"])
        self.player = self._make_player(channels, outlet)
        self.outlet = outlet
        self.request, self.error = 0, ""
        self.next_news_ns, self.has_news = 0, True
        self.time_left = TimeLeft()
        self.subscribe(PlaybackControl, self.on_control, optional=True)

    def _plan(self) -> RunPlan:
        plan = next(RunPlan.load(run.folder) for run in list_runs() if run.run_id == self.run_id)
        if plan.clock.source != self.name:
            raise SettingError(f"set clock.source to {self.name}: a playback turns the run's clock", "file")
        return plan

    def _channels(self, run: Collection[str]) -> list[LogChannel]:
        """Choose the channels to play; log those that cannot be played, and patterns that match nothing."""
        log = self.log_file
        for damage in log.damage:
            self.log.warning("playing only the intact part of the log: %s", damage)
        for pattern in selection.unmatched(log.channels, self.topics):
            self.log.warning("nothing in %s matches the pattern %s", self.file, pattern)
        channels = selection.of_topics(log.channels, self.topics)
        chosen = selection.of_senders(channels, self.senders, set(run) - {self.name})
        if not chosen:
            senders = ", ".join(sorted({channel.sender or "?" for channel in channels}))
            self.log.warning("nothing is played: all messages come from modules that run here, %s", senders)
        return [*chosen, *selection.unplayable(log.channels, self.topics)]

    def _make_outlet(self, translations: dict[int, Translation | str]) -> PacedOutlet | LockstepOutlet:
        for reason in {text for text in translations.values() if isinstance(text, str)}:
            self.log.warning("leaving out %s", reason)
        if self.lockstep is not None:
            outlet = LockstepOutlet(self, translations, self._remember, self.lockstep, self._run_ns)
            outlet.schedule.due_ns |= self.restored["due_ns"] if self.restored else {}
            return outlet
        limits = self.outstanding_limit, self.outstanding_bytes
        return PacedOutlet(self, translations, self._remember, *limits, self.unhandled.count)

    def _make_player(self, channels: list[LogChannel], outlet: Outlet) -> Player:
        log, machine_ns = self.log_file, self.clock.monotonic_ns
        state = self.restored or {"rate": self.rate, "paused": self.paused, "played": 0, "jumps": 0}
        time = LogTime(
            self.clock_writer,
            machine_ns,
            self._run_ns(),
            state["rate"],
            paused=state["paused"],
            lockstep=self.lockstep is not None,
        )
        end_ns = log.end_ns
        if self.end_s is not None and self.end_s < (log.end_ns - log.start_ns) / 1e9:
            end_ns = min(end_ns, log.start_ns + round(self.end_s * 1e9))
        if log.end_ns > LATEST_NS:
            self.log.warning("messages cannot express all times of the log; the clock stays in January 2038")
        gap_ns = None if self.longest_gap_s is None else round(self.longest_gap_s * 1e9)
        tape = Tape(log, channels, self._begin_ns, end_ns, gap_ns)
        if self.restored:
            tape.restore(state["sought_ns"], state["taken"])
        player = Player(tape, time, outlet, machine_ns, log.start_ns, loop=self.loop)
        player.played, player.jumps = state["played"], state["jumps"]
        return player

    @property
    def _begin_ns(self) -> int:
        """The log's time at which playback starts."""
        return self.log_file.start_ns + round(self.start_s * 1e9)

    def _run_ns(self) -> int:
        """Return the run's time; before it has started, the time at which it will start."""
        now_ns = self.clock_writer.now_ns
        return min(self._begin_ns, LATEST_NS) if now_ns is None else now_ns

    # -- during playback ---------------------------------------------------------------------------------

    def on_control(self, control: PlaybackControl) -> None:
        """Carry out a control request, or log why it was refused."""
        self.request, self.error, self.has_news = control.request, "", True
        try:
            self.player.control(control.command, control.value)
        except PlaybackRefused as refusal:
            self.error = str(refusal)
            self.log.error("refused %s from %s: %s", control.command, self.envelope.sender, refusal)
        self._remember()

    def tick(self) -> None:
        """Play what is due; end once the last message was handled."""
        player = self.player
        if self.next_news_ns == 0:
            self._tell()
        player.play()
        if player.time.held and not self.outlet.is_empty():
            self.outlet.wake()
        if self.strict and self.outlet.balance.left_out:
            self.log.error("ended, because strict allows no loss: %s", *self.outlet.balance.left_out)
            self.stop()
        elif player.ended and not player.time.paused and self.outlet.is_empty():
            self._tell()
            self.log.info("the log has ended: %s", self.status)
            self.stop()
        elif self.has_news or (self.lockstep is None and self.clock.monotonic_ns() >= self.next_news_ns):
            self._tell()

    def _tell(self) -> None:
        """Publish the state of the playback. In lockstep it depends on requests alone, not on real time."""
        player, time, log = self.player, self.player.time, self.log_file
        position_ns = time.position_ns
        self.publish(
            PlaybackState(
                file=str(self.file),
                begin=Time.from_nanoseconds(min(log.start_ns, LATEST_NS)),
                end=Time.from_nanoseconds(min(player.tape.end_ns, LATEST_NS)),
                position=Time.from_nanoseconds(position_ns),
                rate=math.inf if time.rate is None else time.rate,
                paused=time.paused,
                loop=player.loop,
                lockstep=self.lockstep is not None,
                ended=player.ended,
                messages=player.played,
                jumps=player.jumps,
                request=self.request,
                error=self.error,
            )
        )
        self.next_news_ns, self.has_news = self.clock.monotonic_ns() + TELL_EVERY_NS, False
        self._show(position_ns)

    def _show(self, position_ns: int) -> None:
        player, time = self.player, self.player.time
        pace = "as fast as possible" if time.rate is None else f"rate {time.rate:g}"
        at_s, end_s = ((ns - self.log_file.start_ns) / 1e9 for ns in (position_ns, player.tape.end_ns))
        skipped = f", {self.outlet.skipped} left out" if self.outlet.skipped else ""
        state, now_s = (time.paused, time.rate, player.jumps), self.clock.monotonic_ns() / 1e9
        left = self.time_left.text(state, now_s, at_s, end_s)
        self.status = (
            f"{at_s:.1f} of {end_s:.1f} s, {left}{player.played} messages{skipped}, "
            f"{'paused' if time.paused else pace}"
        )

    def _remember(self, sent: int = 0) -> None:
        """Checkpoint the position for the next incarnation; `sent`: messages the player has not counted."""
        player = self.player
        self.checkpoint(
            {
                "sought_ns": player.tape.sought_ns,
                "taken": player.tape.taken + sent,
                "rate": player.time.rate,
                "paused": player.time.paused,
                "played": player.played + (sent if not player.tape.gives else 0),
                "jumps": player.jumps,
                "balance": _counted(self.outlet.balance, sent),
                "due_ns": self.outlet.schedule.due_ns if isinstance(self.outlet, LockstepOutlet) else {},
            }
        )

    def teardown(self) -> None:
        """Stop the run's time where it is; write what was left out."""
        for damage in self.log_file.damage:
            self.outlet.balance.leave_out(f"damage in the log: {damage}")
        self.write_result(BALANCE_FILE, json.dumps(_counted(self.outlet.balance)) + "\n")
        self.clock_writer.pause(self._run_ns())
        self.clock_writer.close()
        self.unhandled.close()
        self.log_file.close()


def _open(settings: dict[str, Any]) -> Log:
    try:
        return open_log(settings["file"], ReadLimits(chunk_bytes=settings["max_chunk_bytes"]))
    except LogError as error:
        raise SettingError(str(error), "file") from error


def _translations(channels: Iterable[LogChannel], types: RunTypes) -> dict[int, Translation | str]:
    """Return how the messages of each channel are published, or why they are left out, by channel id.

    Raises:
        SettingError: the robot's own log has versions that its program cannot upgrade; the text names them.
    """
    found: dict[int, Translation | str] = {}
    problems: dict[str, None] = {}
    for channel in channels:
        name = channel_name(channel)
        try:
            if selection.is_readable(channel):
                found[channel.id] = translation_of(channel, types)
            else:
                found[channel.id] = f"messages of {name!r}, which are encoded as {channel.encoding!r}"
        except MessageError as error:
            why = "it has other fields than ours" if isinstance(error, VersionError) else error
            found[channel.id] = f"messages of {name!r}, whose {channel.type_name} does not fit: {why}"
            if not channel.is_foreign:
                problems[f"{error} (it is in the log; `topics` can leave it out)"] = None
    if problems:
        raise SettingError("\n".join(problems), "file")
    return found


def _refuse_loss(log: Log, translations: dict[int, Translation | str]) -> None:
    losses = [*log.damage, *(text for text in translations.values() if isinstance(text, str))]
    if losses:
        raise SettingError("\n".join(losses), "strict")


def _counted(balance: Balance, sent: int = 0) -> dict[str, Any]:
    return {"used": balance.used + sent, "left_out": balance.left_out}


def _count(balance: Balance, counted: dict[str, Any]) -> None:
    balance.use(counted["used"])
    for reason, count in counted["left_out"].items():
        balance.leave_out(reason, count)


def played_balance(folder: Path) -> Balance | None:
    """Return the balance of a playback from the folder for the results of its run; None without one."""
    balance = Balance()
    try:
        _count(balance, json.loads((folder / BALANCE_FILE).read_text()))
    except (OSError, ValueError, KeyError):
        return None
    return balance
