"""The shadow of a module of a run that goes on."""

import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass

from robbie_mp.attached.tool.message_stream import MessageStream
from robbie_mp.attached.tool.tool import Received, RunEnded
from robbie_mp.bus.checkpoint.buffers import newest_checkpoint
from robbie_mp.bus.observe import ModuleFigures, RunObserver
from robbie_mp.bus.transport.declarations import read_declarations
from robbie_mp.bus.transport.histogram import Distribution
from robbie_mp.bus.transport.segment import SegmentMissing
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.logs.capture.recorded_run import RecordedRun
from robbie_mp.logs.shadow.beside import ShadowProcess
from robbie_mp.logs.shadow.comparison import Comparison, ShadowReport, distribution_of
from robbie_mp.logs.shadow.frames import Begin, Given
from robbie_mp.logs.shadow.pairing import Side
from robbie_mp.run.profile.model import ModuleSpec
from robbie_mp.run.run_directory import KnownRun

WAIT_S = 0.01
LOOK_EVERY_S = 0.5
DRAIN_S = 3.0
"""At the end, the shadow has so long to handle what it was given."""
MOST_SEEN = 256


def begin_of(spec: ModuleSpec, workspace: str) -> Begin:
    """Return what the process of a shadow must know."""
    return Begin(
        name=spec.name,
        class_path=spec.class_path,
        code=spec.code,
        workspace=workspace,
        settings=dict(spec.settings),
        topics=dict(spec.topics),
        namespace=spec.namespace,
        folder="",
        process_bytes=spec.memory.process_bytes,
    )


@dataclass(frozen=True)
class Times:
    """Figures of a module at one moment."""

    figures: ModuleFigures

    def since(self, before: "Times") -> Distribution | None:
        """Return the times for a message since then; None if the module has restarted."""
        now, then = self.figures.work, before.figures.work
        if now is None or then is None or self.figures.incarnation != before.figures.incarnation:
            return None
        return now.handler.distribution(then.handler)


class ShadowOfRun:
    """Attaches to a run as a tool, and feeds a shadow with what a module of it gets.

    Args:
        run: the run.
        spec: the variant, with all its settings.
        is_fresh: whether it begins without the module's checkpoint.
    """

    def __init__(self, run: KnownRun, spec: ModuleSpec, *, is_fresh: bool):
        self._run = run
        self._spec = spec
        self._name = spec.name
        self._is_fresh = is_fresh
        self._seen: OrderedDict[int, None] = OrderedDict()
        self._known: set[ChannelName] = set()
        self._last_ns = 0
        self._look_at_s = 0.0

    def watch(self, is_over: Callable[[], bool], on_begin: Callable[[], None]) -> ShadowReport:
        """Run the shadow until it, the run or the time is over.

        Args:
            is_over: asked often.
            on_begin: called when the shadow has been set up.

        Raises:
            ShadowFailed: it cannot be set up.
            ControlRefused, RunNotControlled: this tool cannot attach to the run.
        """
        with (
            closing(RecordedRun(self._run.folder)) as recorded,
            closing(RunObserver(self._run.run_id)) as observer,
            ShadowProcess(
                begin_of(self._spec, recorded.plan.workspace),
                self._spec.scheduling.compute_threads,
                is_over,
            ) as shadow,
        ):
            shadow.wait_until_ready()
            self._known = self._declared()
            purpose = f"robbie shadow {self._name}"
            with closing(MessageStream(self._run, sorted(self._known), purpose)) as stream:
                slot = recorded.plan.names.index(self._name)
                checkpoint = None if self._is_fresh else newest_checkpoint(recorded.plan.run_id, slot)
                # What the module handled before its checkpoint must not be given to the shadow.
                age_ns = 0 if checkpoint is None else max(0, time.time_ns() - checkpoint.taken_ns)
                begin_ns = recorded.time_ns(time.monotonic_ns() - age_ns)
                shadow.start(begin_ns, None if checkpoint is None else checkpoint.image)
                self._subscribe(stream, shadow)
                on_begin()
                before = self._times(observer)
                comparison = Comparison(begin_ns, recorded.schema)
                self._last_ns = begin_ns
                self._begin_ns = begin_ns
                self._feed(stream, shadow, comparison, recorded, is_over)
                after = self._times(observer)
                return ShadowReport(
                    channels=comparison.end(min(shadow.done_ns, self._last_ns)),
                    handled=shadow.handled,
                    lost=shadow.feed.lost + stream.missed,
                    replaced=shadow.feed.replaced,
                    unhandled=shadow.unhandled,
                    calls=shadow.calls,
                    module_times=after.since(before) if before and after else None,
                    shadow_times=distribution_of(list(shadow.times_ns)),
                    end=shadow.end,
                    from_checkpoint=checkpoint is not None,
                )

    def _feed(
        self,
        stream: MessageStream,
        shadow: ShadowProcess,
        comparison: Comparison,
        recorded: RecordedRun,
        is_over: Callable[[], bool],
    ) -> None:
        drain_until_s: float | None = None
        try:
            while not shadow.end:
                if drain_until_s is None and is_over():
                    drain_until_s = time.monotonic() + DRAIN_S
                if drain_until_s is not None and (not shadow.unhandled or time.monotonic() > drain_until_s):
                    break
                if received := stream.receive(WAIT_S):
                    self._take(received, shadow, comparison, recorded, is_fed=drain_until_s is None)
                elif drain_until_s is None:
                    self._pass_time(shadow, recorded)
                for said in shadow.pump(0.0):
                    name = ChannelName(said.type_name, said.version, said.topic)
                    comparison.add(Side.SHADOW, name, said.time_ns, said.data)
                self._look(stream, shadow, comparison)
        except RunEnded:
            return

    def _take(
        self,
        received: Received,
        shadow: ShadowProcess,
        comparison: Comparison,
        recorded: RecordedRun,
        *,
        is_fed: bool,
    ) -> None:
        if received.sequence in self._seen:
            return  # it came for another subscription, too
        self._seen[received.sequence] = None
        while len(self._seen) > MOST_SEEN:
            self._seen.popitem(last=False)
        name = ChannelName(received.type_name, received.version, received.topic)
        time_ns = recorded.time_ns(received.published_ns)
        if received.sender == self._name and time_ns >= self._begin_ns:
            comparison.add(Side.MODULE, name, time_ns, received.data)
        if not is_fed or (time_ns < self._begin_ns and name not in recorded.latched()):
            return
        wanted = shadow.wants(*name)
        if wanted is not False:
            self._last_ns = max(self._last_ns, time_ns)
            given = Given(time_ns, *name, received.sender, received.data)
            shadow.feed.add(given, only_newest=wanted is None)

    def _pass_time(self, shadow: ShadowProcess, recorded: RecordedRun) -> None:
        self._last_ns = max(self._last_ns, recorded.time_ns(time.monotonic_ns()))
        if not len(shadow.feed):
            shadow.feed.add(Given(self._last_ns))

    def _look(self, stream: MessageStream, shadow: ShadowProcess, comparison: Comparison) -> None:
        """Notice new subscriptions and publications, now and then."""
        now_s = time.monotonic()
        if now_s < self._look_at_s:
            return
        self._look_at_s = now_s + LOOK_EVERY_S
        comparison.expire(min(shadow.done_ns, self._last_ns))
        self._subscribe(stream, shadow)

    def _subscribe(self, stream: MessageStream, shadow: ShadowProcess) -> None:
        wanted = {ChannelName(*one[:3]) for one in shadow.subscriptions or ()} | self._declared()
        for name in sorted(wanted - self._known):
            self._known.add(name)
            stream.subscribe(name)

    def _declared(self) -> set[ChannelName]:
        """Return what the module publishes and subscribes to."""
        try:
            return {one.name for one in read_declarations(self._run.run_id) if one.module == self._name}
        except SegmentMissing:
            return set()

    def _times(self, observer: RunObserver) -> Times | None:
        return next((Times(one) for one in observer.modules() if one.name == self._name), None)
