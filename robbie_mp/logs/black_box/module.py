"""The module of the black box, which `robbie run` adds to every robot."""

import contextlib
import logging
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

from robbie_mp.base.linux.private_files import make_private_folder
from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.transport.channels import ChannelCounters, messages_waiting
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.logs.black_box.clip_folder import ClipFolder, clip_name
from robbie_mp.logs.black_box.clip_writer import ClipWriter
from robbie_mp.logs.black_box.end_watch import EndWatch
from robbie_mp.logs.black_box.large_messages import RAW_SHARE, LargeMessages
from robbie_mp.logs.black_box.ring import RING, STATE, ring_home, ring_parts
from robbie_mp.logs.black_box.spool import AboutSpool, Spool
from robbie_mp.logs.black_box.state import MAX_OPEN, BoxState, OpenClip
from robbie_mp.logs.black_box.triggers import ChannelTriggers, TriggerError, triggers_of
from robbie_mp.logs.message_logger import MessageLogger
from robbie_mp.logs.recording.chunk import Compression
from robbie_mp.logs.recording.disk_budget import DiskBudget
from robbie_mp.logs.recording.format import ChannelKey, RecordedCount, part_path
from robbie_mp.logs.recording.log_writer import LogWriter, Split
from robbie_mp.logs.recording.newest import KeepLimits
from robbie_mp.messages import Clip, DecodeError, Mark, SchemaError, Time, message_type_from_schema
from robbie_mp.module.envelope import EncodedMessage
from robbie_mp.module.module import setting
from robbie_mp.module.settings import SettingError
from robbie_mp.run.profile.model import CLIPS_BYTES

CLIP_TOPIC = "clips"
MARK = "mark: "
"""Begin of a trigger that is a mark."""
PART_S = 4.0
"""The ring's parts are this long; a clip consists of whole parts."""
COUNT_S = 1.0
PART_SHARE, LATCHED_SHARE = 8, 8
"""A part, and the copies of latched messages at its beginning, are at most this fraction of the ring."""
GIVE_UP_NS = 10_000_000_000
CLOSE_S = 6.0
"""How long the end of a run waits for clips."""
FLUSH_S = 0.2
"""How long a trigger waits until what was before it outlives this process."""
TRIGGER_CHARACTERS = 200
UNSEEN = "messages that may be triggers were dropped before the black box got them"


class BlackBox(MessageLogger):
    """Keeps the last messages in shared memory, as a log in short parts, and copies parts to disk as clips.

    The parts outlive this process, and the run: the next process goes on with them, and if the supervisor
    was killed, the next `robbie run` or `robbie clean` makes a clip of them.
    """

    period_s = 0.25
    tells_where = logging.DEBUG

    types = ["*"]  # noqa: RUF012 - settings of the logger, which no profile can change here
    topics = ["*"]  # noqa: RUF012
    folder = None
    compression = Compression.ZSTD
    chunk_bytes = 1 << 18
    split_bytes = 0
    split_s = 0.0
    budget_bytes = 0
    sync_s = 1.0
    buffer_bytes = 1 << 25

    before_s: float = setting(20.0, "seconds before a trigger that a clip has", minimum=1.0, maximum=3600.0)
    after_s: float = setting(5.0, "seconds after a trigger that a clip has", minimum=0.0, maximum=50.0)
    ring_bytes: int = setting(64 << 20, "shared memory for the last messages", minimum=1 << 20)
    clips_bytes: int = setting(
        CLIPS_BYTES, "disk space for the clips of this and earlier runs", minimum=1 << 20
    )
    large_bytes: int = setting(1 << 18, "messages of this size are thinned out", minimum=1 << 10)
    large_every_s: float = setting(0.5, "time between those that are kept of a topic", minimum=0.0)
    jpeg_quality: int = setting(75, "of images kept as JPEG; 0: as they are", minimum=0, maximum=95)
    spool_s: float = setting(
        5.0, "time within which small messages are on the disk, for a power cut; 0: never", minimum=0.0
    )
    spool_bytes: int = setting(8 << 20, "disk space for these messages", minimum=1 << 18)
    triggers: list[str] = setting([], "further triggers, such as battery.percentage < 0.1")

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Check the triggers."""
        texts = settings["triggers"]
        try:
            triggers_of(map(str, texts if isinstance(texts, list) else []))
        except TriggerError as error:
            raise SettingError(str(error), "triggers") from error

    def setup(self) -> None:
        """Go on with what an earlier process has left, and subscribe to everything."""
        self.home = ring_home(self.run_id)
        make_private_folder(self.home)
        self.state, problem = BoxState.load(self.home / STATE)
        if problem:
            self.log.error("%s; its triggers may have no clip", problem)
            self.state.miss(1, "state of the black box lost")
        self.ended_ns = dict.fromkeys(ring_parts(self.home / RING), time.monotonic_ns())
        """When each part of the ring ended, by number."""
        self.large = LargeMessages(
            self.large_every_s, self.ring_bytes * RAW_SHARE / self.before_s, self.jpeg_quality
        )
        self.left_out = 0
        self.field_triggers = triggers_of(self.triggers)
        self.may_trigger: dict[tuple[str, str], bool] = {}
        """Whether messages of a type and topic may be triggers."""
        self.watched: dict[ChannelKey, ChannelTriggers | None] = {}
        self.folder_of_clips = ClipFolder(self.output_directory, self.clips_bytes)
        super().setup()
        self._keep_epoch()
        profile = self.run.plan.profile_name
        about = AboutSpool(self.run_id, profile, self.clips_bytes)
        self.spool = (
            Spool(self.output_directory, about, self.run, self.spool_bytes, self.spool_s, self.log)
            if self.spool_s
            else None
        )
        self.writer = ClipWriter(self.home / RING, self.folder_of_clips, self.run_id, profile, self.log)
        self.slot = self.run.plan.names.index(self.name)
        self.ends = EndWatch(self.run_id, self.run.plan.names, self.state.seen)
        self.newest_ns = self.began_ns
        """When the newest message that has arrived was published."""
        self.part_due_ns = self.count_due_ns = self.began_ns

    def _keep_epoch(self) -> None:
        """Have one time in all of the run's clips, though the clock is set and this process killed."""
        if self.state.epoch_ns:
            self.run.epoch_ns = self.state.epoch_ns
        else:
            self.state.epoch_ns = self.run.epoch_ns
            self._save()

    def recording_folder(self) -> Path:
        """Return the folder of the ring."""
        return self.home / RING

    def make_writer(self, recording: Path, dropped: Callable[[], Mapping[ChannelKey, int]]) -> LogWriter:
        """Make the writer of the ring, whose oldest parts make room for new ones."""
        keep = self.run.keep_limits
        return LogWriter(
            recording,
            self.compression,
            self.run.metadata(),
            Split(self.ring_bytes // PART_SHARE),
            DiskBudget(self.home, self.ring_bytes),
            dropped,
            self.end_part,
            KeepLimits(keep.messages, min(keep.bytes, self.ring_bytes // LATCHED_SHARE)),
        )

    def end_part(self, number: int, counts: Mapping[ChannelKey, RecordedCount]) -> None:
        """Note that a part of the ring has ended."""
        super().end_part(number, counts)
        self.ended_ns[number] = time.monotonic_ns()

    # -- messages --------------------------------------------------------------------------------------

    def on_message(self, message: EncodedMessage) -> None:
        """Keep a message, and see whether it is a trigger."""
        envelope, data = self.envelope, message.data
        key = ChannelKey(message.type_name, message.version, envelope.topic, envelope.sender)
        self.newest_ns = envelope.published_ns
        watched = self.watched[key] if key in self.watched else self._watch(key)
        is_new = envelope.sequence > self.position.sequence  # not one that the core has kept from before
        if len(data) < self.large_bytes:
            self.session.record(key, envelope.sequence, envelope.published_ns, data)
        else:
            self._thin(key, data)
        if is_new and self.spool is not None:
            self.spool.keep(key, envelope.sequence, envelope.published_ns, data)
        if watched is not None:
            self._check_triggers(key, watched, data, is_new=is_new)

    def _thin(self, key: ChannelKey, data: memoryview) -> None:
        envelope = self.envelope
        kept = self.large.take(key, data)
        if kept is not None and kept[0] == key:
            self.session.record(key, envelope.sequence, envelope.published_ns, data)
            return
        self.session.leave_out(key, envelope.sequence, envelope.published_ns, data)
        if kept is None:
            self.left_out += 1
        else:
            self.session.add(kept[0], envelope.sequence, envelope.published_ns, kept[1])

    def _watch(self, key: ChannelKey) -> ChannelTriggers | None:
        """Find the triggers that are about a channel."""
        self.watched[key] = None
        if not self._may_trigger(key.type_name, key.topic):
            return None
        fields = {
            trigger: field
            for trigger in self.field_triggers
            if (field := trigger.field_of(key.type_name, key.topic))
        }
        schema = self.run.schema(key.type_name, key.version)
        try:
            if schema is None:
                raise TriggerError(f"no class describes {key.type_name}, version {key.version}")
            known = message_type_from_schema(key.type_name, schema, key.version)
            holds = {trigger.text: trigger.comparison(known, field) for trigger, field in fields.items()}
        except (TriggerError, SchemaError) as error:
            self.log.warning("messages of topic %r trigger nothing: %s", key.topic, error)
            return None
        self.watched[key] = found = ChannelTriggers(known.decode, holds)
        return found

    def _check_triggers(
        self, key: ChannelKey, watched: ChannelTriggers, data: memoryview, *, is_new: bool
    ) -> None:
        try:
            fired = list(watched.fired(data))
            if key.type_name == Mark.type_name:
                fired.append(MARK + Mark.decode(data).text)
        except DecodeError as error:
            self.log.warning("a message of topic %r cannot be read: %s", key.topic, error)
            self.state.miss(1, "message that cannot be read")
            return
        for text in fired if is_new else ():
            self.trigger(text, self.envelope.published_ns)

    def trigger(self, what: str, at_ns: int) -> None:
        """Begin a clip, or make the one longer that is open.

        Args:
            what: what happened.
            at_ns: when, on the machine's monotonic clock.
        """
        now_ns = time.monotonic_ns()
        at_ns = min(at_ns, now_ns) or now_ns
        what = one_line(what)[:TRIGGER_CHARACTERS]
        open_ = [clip for clip in self.state.open if clip.takes(now_ns)]
        if not open_ and len(self.state.open) >= MAX_OPEN:
            self.state.miss(1, "too many clips at once")
            return
        clip = open_[0] if open_ else self._new_clip(what, at_ns)
        has_news = clip.add(what, now_ns, self.run.time_ns(at_ns) / 1e9, self.after_s)
        if has_news:
            self.log.info("clip %s: %s", clip.name, what)
            # Before the clip is announced: this process may be killed at any time.
            self.session.recorder.flush(FLUSH_S)
            self._save()
            self._announce(clip, Clip.OPEN)

    def _new_clip(self, what: str, at_ns: int) -> OpenClip:
        since_ns = at_ns - round(self.before_s * 1e9)
        ended = sorted(self.ended_ns.copy().items())
        first = next((number for number, ended_ns in ended if ended_ns >= since_ns), None)
        taken = [*self.folder_of_clips.names(), *(clip.name for clip in self.state.open)]
        clip = OpenClip(
            name=clip_name(what, taken, self.run.time_ns(at_ns) / 1e9),
            at_ns=at_ns,
            until_ns=0,
            first=(max(self.ended_ns.copy(), default=-1) + 1) if first is None else first,
        )
        self.state.open.append(clip)
        return clip

    def _announce(self, clip: OpenClip, state: int, size: int = 0, reason: str = "") -> None:
        self.publish(
            Clip(
                stamp=Time.from_nanoseconds(time.time_ns()),
                folder=str(self.folder_of_clips.path / clip.name),
                state=state,
                triggers=list(clip.triggers),
                bytes=size,
                reason=reason,
            ),
            topic=CLIP_TOPIC,
            latched=True,
        )

    def _save(self) -> None:
        try:
            self.state.save(self.home / STATE)
        except OSError as error:
            self.log.error("triggers are forgotten if the black box is killed now: %s", error)

    # -- ticks -----------------------------------------------------------------------------------------

    def tick(self) -> None:
        """See what has ended, move clips on, and make room in the ring."""
        now_ns = time.monotonic_ns()
        before = dict(self.state.seen)
        for what, at_ns in self.ends.look():
            self.trigger(what, at_ns)
        if self.state.seen != before:
            self._save()
        if now_ns >= self.part_due_ns:
            self.part_due_ns = now_ns + round(PART_S * 1e9)
            self._end_part()
        self._move_clips(now_ns)
        self._take_results()
        if now_ns >= self.count_due_ns:
            self.count_due_ns = now_ns + round(COUNT_S * 1e9)
            self._count_missed()
            self._count_lost(wait_s=0.0)
            self._count_unseen()
            self._forget_old(now_ns)
            self._show(now_ns)

    def _count_unseen(self) -> None:
        """Count as missed the messages that may have been triggers, but never reached this module.

        The core counts what has passed through a channel, the tally what processes of this module have got.
        """
        if self.tally is None:
            return
        waiting = messages_waiting(self.run.core, self.slot)
        passed = ChannelCounters(self.run.core).messages()
        heard: Counter[ChannelName] = Counter()
        for key, received in self.tally.received().items():
            heard[ChannelName(*key[:3])] += received
        unseen = sum(
            max(0, number - heard[name] - waiting)
            for name, number in passed.items()
            if self._may_trigger(name.type_name, name.topic)
        )
        if unseen > self.state.unseen:
            self.state.miss(unseen - self.state.unseen, UNSEEN)
            self.state.unseen = unseen
            self._save()

    def _may_trigger(self, type_name: str, topic: str) -> bool:
        known = self.may_trigger.get((type_name, topic))
        if known is None:
            known = self.selection.wants(type_name, topic) and (
                type_name == Mark.type_name
                or any(trigger.field_of(type_name, topic) for trigger in self.field_triggers)
            )
            self.may_trigger[type_name, topic] = known
        return known

    def _end_part(self) -> None:
        self._count_missed()  # so that the part counts what is missing from it
        self.session.recorder.end_part()

    def _move_clips(self, now_ns: int, *, is_end: bool = False) -> None:
        for clip in self.state.open:
            if clip.last < 0 and (is_end or self._has_all(clip, now_ns)):
                clip.last = max([clip.first - 1, *ring_parts(self.home / RING)])
                if not is_end:
                    self._end_part()
                self._save()
            ready = {number for number in self.ended_ns.copy() if number >= clip.first}
            wanted = set(range(clip.first, clip.last + 1))
            is_late = is_end or now_ns > clip.until_ns + 2 * GIVE_UP_NS
            is_whole = clip.last >= 0 and (is_late or wanted <= ready)
            parts = ready if clip.last < 0 else ready & wanted
            self.writer.copy(clip, parts, is_whole=is_whole)

    def _has_all(self, clip: OpenClip, now_ns: int) -> bool:
        """Whether all messages of a clip have arrived: on a busy machine, some may still wait."""
        if now_ns <= clip.until_ns:
            return False
        is_late = now_ns > clip.until_ns + GIVE_UP_NS or self.newest_ns > clip.until_ns
        return is_late or not messages_waiting(self.run.core, self.slot)

    def _take_results(self) -> None:
        while self.writer.results:
            result = self.writer.results.popleft()
            clip = result.clip
            self.state.open = [one for one in self.state.open if one.name != clip.name]
            self.state.clips += result.bytes > 0
            if result.missing:
                self.state.miss(clip.count, result.missing)
                self.log.error("clip %s is missing, or not whole: %s", clip.name, result.missing)
            else:
                self.state.written += clip.count
            self._save()
            outcome = Clip.MISSED if result.missing else Clip.WRITTEN
            self._announce(clip, outcome, result.bytes, result.missing)

    def _forget_old(self, now_ns: int) -> None:
        """Remove parts of the ring that are too old, unless a clip needs them."""
        oldest_ns = now_ns - round((self.before_s + PART_S) * 1e9)
        needed = min((clip.first for clip in self.state.open), default=None)
        for number, ended_ns in sorted(self.ended_ns.copy().items()):
            path = part_path(self.home / RING, number)
            if ended_ns < oldest_ns and (needed is None or number < needed):
                with contextlib.suppress(OSError):
                    path.unlink()
            if not path.exists():
                del self.ended_ns[number]

    def _show(self, now_ns: int) -> None:
        """Show what is kept, and what has become of all triggers; a count of zero says nothing."""
        state, recorder = self.state, self.session.recorder
        first_ns = min(self.ended_ns.copy().values(), default=now_ns)
        if self.spool is not None:
            self.spool.look()
        counts = {
            f"{state.triggers} triggers": state.triggers,
            f"{state.clips} clips": state.clips,
            self._missed(): state.missed,
            f"{len(state.open)} open": state.open,
            f"left out {self.left_out} large messages": self.left_out,
            f"removed {self.folder_of_clips.removed} old clips": self.folder_of_clips.removed,
            f"dropped {self.session.missed}": self.session.missed,
        }
        if self.spool is not None:
            counts[f"left out {self.spool.left_out} of the spool"] = self.spool.left_out
        kept = f"keeps {(now_ns - first_ns) / 1e9 + PART_S:.0f} s"
        errors = [recorder.error and f"cannot keep messages: {recorder.error}"]
        errors.append(self.writer.error and f"cannot write clips: {self.writer.error}")
        if self.spool is not None and self.spool.problem:
            errors.append(f"a power cut would lose the last messages: {self.spool.problem}")
        self.degraded = "; ".join(filter(None, errors))
        self.status = ", ".join([kept, *(text for text, count in counts.items() if count)])

    def _missed(self) -> str:
        reasons = ", ".join(f"{number}: {reason}" for reason, number in self.state.missed.items())
        return f"{sum(self.state.missed.values())} missed" + (f" ({reasons})" if reasons else "")

    def teardown(self) -> None:
        """End the ring, and write the clips that are open."""
        for what, at_ns in self.ends.look():
            self.trigger(what, at_ns)
        self.ends.close()
        self._count_unseen()
        self._end_log()
        self._move_clips(time.monotonic_ns(), is_end=True)
        if not self.writer.close(CLOSE_S):
            self.log.error("the run ends before all clips are written")
        self._take_results()
        for clip in self.state.open:
            self.log.error("clip %s is missing, or not whole: the run has ended", clip.name)
            self.state.miss(clip.count, "the run has ended")
        self.state.open = []
        self._save()
        if self.spool is not None:
            self.spool.close()
        if not self.state.triggers:
            self.status = ""
            return
        self.log.info(
            "%d triggers, %d with a clip on the disk, %s",
            self.state.triggers,
            self.state.written,
            self._missed(),
        )
