"""Foxglove's server, and what its threads hand over to the module's thread.

The SDK calls its listener in threads of its own. They never touch the bus: they put what comes in into a
bounded queue, or change a set under a lock, and wake the module.
"""

from __future__ import annotations

import logging
import os
import threading
from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import unquote, urlsplit

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.extras import how_to_install
from robbie_mp.connect.foxglove.frames import GREETING_CHANNEL
from robbie_mp.messages.schema_parser import MAX_TEXT_BYTES

if TYPE_CHECKING:
    import foxglove

MAX_WAITING = 256
"""Most things that may wait for the module's thread."""
MAX_WAITING_BYTES = 64 << 20
MAX_CLIENT_CHANNELS = 64
"""Most channels that a client may announce."""
MAX_SCHEMA_BYTES = 16 << 20
"""Size of the schemas of clients that are kept."""
MAX_ASSET_BYTES = 64 << 20
SDK_THREADS = "1"
"""Threads in which the SDK sends. With one for each processor, a large message would take all at once."""
ANSWER_LIMIT_S = 2.0
"""A service without an answer for this time has failed."""
SET_BOOL = "bool data"
RESPONSE = "bool success\nstring message"
CDR = "cdr"
JSON = "json"
CLIENT_LOGGER = "foxglove.websocket.connected_client.poller"
"""The SDK's logger for what comes from clients."""
SERVICE_PROVIDER = "foxglove"
ROS2MSG = "ros2msg"


class FoxgloveMissing(RobbieError, ImportError):
    """The extra `foxglove` is not installed."""


class ClientChannel(NamedTuple):
    """A channel of a client.

    Attributes:
        topic: its topic.
        type_name: the name of its type.
        encoding: the encoding of its messages.
        schema_encoding: how the client describes the type, such as `ros2msg`; "" if it does not.
        schema: the description; None if there is none, it is too large, or the server keeps enough already.
    """

    topic: str
    type_name: str
    encoding: str
    schema_encoding: str = ""
    schema: bytes | None = None


class FromClient(NamedTuple):
    """A message that a client has published."""

    channel: ClientChannel
    data: bytes
    arrived_ns: int
    """Monotonic time of the module."""
    age_s: float
    """How old it was then at most; infinite if that is not known."""


class ParameterWish(NamedTuple):
    """A value that a client wants a setting to have."""

    name: str
    value: object


class ServiceCall:
    """A call of a service by a client.

    Attributes:
        name: the service.
        data: the encoded request.
        arrived_ns: monotonic time of the module.
    """

    def __init__(self, name: str, data: bytes, arrived_ns: int):
        self.name = name
        self.data = data
        self.arrived_ns = arrived_ns
        self._answered = threading.Event()
        self._answer = b""

    def answer(self, data: bytes) -> None:
        """Give the encoded response; the module's thread calls this."""
        self._answer = data
        self._answered.set()

    def wait(self) -> bytes:
        """Return the encoded response.

        Raises:
            TimeoutError: the module has not answered in time.
        """
        if not self._answered.wait(ANSWER_LIMIT_S):
            raise TimeoutError("the robot has not answered in time")
        return self._answer


Arrived = FromClient | ParameterWish | ServiceCall
Connections = Mapping[str, Collection[str]]
"""Names of modules by topic."""


@dataclass(frozen=True)
class ServerOptions:
    """How the server behaves.

    Attributes:
        name: shown by Foxglove.
        greeting_topic: begins the topics by which the door tells who came through it.
        queue_messages: messages that wait for each client; then the oldest is dropped.
        max_message_bytes: size of the largest message that is taken from a client.
        services: names of services and whether their request has a bool.
        assets: folders whose files clients may read, by the name of their package.
        foreign_topics: topics on which clients may publish types that the robot does not know.
        tells_time: whether the run's time is another than that of clients.
    """

    name: str
    greeting_topic: str
    queue_messages: int
    max_message_bytes: int
    services: Mapping[str, bool]
    assets: Mapping[str, Path]
    foreign_topics: Collection[str] = ()
    tells_time: bool = False


class ClientServer:
    """Serves channels, parameters, services and assets to clients.

    Args:
        options: how it behaves.
        wake: wakes the module; any thread may call it.
        now_ns: the module's monotonic time; any thread may call it.
        age_s: how old what comes now from a client, as numbered by the door, can be at most.

    Attributes:
        parameters: the parameters by name; replaced as a whole.
        is_breached: whether a client came past the door, by the port inside.
        overflowed: what clients sent and the module's queue had no place for.
        oversized: messages of clients that were too large.
    """

    def __init__(
        self,
        options: ServerOptions,
        wake: Callable[[], None],
        now_ns: Callable[[], int],
        age_s: Callable[[int], float],
    ):
        try:
            import foxglove  # noqa: PLC0415 - an extra
        except ImportError as error:
            raise FoxgloveMissing(
                f"Foxglove needs the extra `foxglove`: {how_to_install('foxglove')}"
            ) from error
        self._foxglove = foxglove
        self._options, self._wake, self._now_ns, self._age_s = options, wake, now_ns, age_s
        self._lock = threading.Lock()
        self._waiting: deque[Arrived] = deque()
        self._waiting_bytes = 0
        self._clients: dict[int, int] = {}
        self._announced: dict[tuple[int, int], ClientChannel] = {}
        self._readers: dict[int, set[int]] = {}
        self._new_readers: set[int] = set()
        self.parameters: Mapping[str, Any] = {}
        self.is_breached = False
        self.overflowed = 0
        self.oversized = 0
        os.environ.setdefault("TOKIO_WORKER_THREADS", SDK_THREADS)
        self._context = foxglove.Context()
        logging.getLogger(CLIENT_LOGGER).addFilter(_is_worth_telling)
        capability = foxglove.websocket.Capability
        capabilities = [
            capability.ClientPublish,
            capability.Parameters,
            capability.Services,
            capability.ConnectionGraph,
        ]
        self._server = foxglove.start_server(
            name=options.name,
            host="127.0.0.1",
            port=0,
            capabilities=[*capabilities, capability.Time] if options.tells_time else capabilities,
            server_listener=self,
            supported_encodings=[CDR, JSON],
            services=[self._service(*one) for one in options.services.items()],
            asset_handler=self.on_asset,  # without one, a client would wait for its files in vain
            context=self._context,
            message_backlog_size=options.queue_messages,
        )
        self.port: int = self._server.port

    def close(self) -> None:
        """Stop serving; all clients are disconnected."""
        self._server.stop()

    # -- for the module's thread -------------------------------------------------------------------------

    def open_channel(self, topic: str, schema_name: str, schema: str) -> foxglove.Channel:
        """Offer a channel to all clients.

        Args:
            topic: its name.
            schema_name: full name of the type.
            schema: the type as ros2msg text.
        """
        described = self._foxglove.Schema(name=schema_name, encoding=ROS2MSG, data=schema.encode())
        return self._foxglove.Channel(topic, schema=described, message_encoding=CDR, context=self._context)

    def readers(self) -> dict[int, set[int]]:
        """Return which clients, as numbered by the door, read which channel; without those nobody reads."""
        with self._lock:
            return {
                channel: {self._clients.get(client, 0) for client in clients}
                for channel, clients in self._readers.items()
                if clients
            }

    def take_new_readers(self) -> set[int]:
        """Return the channels that have got a further reader since the last call."""
        with self._lock:
            new, self._new_readers = self._new_readers, set()
        return new

    def take(self) -> Arrived | None:
        """Return what came first from the clients; None if nothing waits."""
        with self._lock:
            if not self._waiting:
                return None
            first = self._waiting.popleft()
            self._waiting_bytes -= _size(first)
        return first

    def show_parameters(self, parameters: Mapping[str, Any]) -> None:
        """Replace the parameters, and tell the clients which have changed.

        Args:
            parameters: values by name.
        """
        changed = {
            name: value for name, value in parameters.items() if self.parameters.get(name, self) != value
        }
        self.parameters = parameters
        if changed:
            self._server.publish_parameter_values([self._parameter(*one) for one in changed.items()])

    def show_problem(self, text: str, about: str | None = None) -> None:
        """Show a text to all clients.

        Args:
            text: the text.
            about: what it is about; it replaces the last text about that.
        """
        self._server.publish_status(text, self._foxglove.websocket.StatusLevel.Warning, about)

    def tell_time(self, run_ns: int) -> None:
        """Tell all clients the run's time."""
        self._server.broadcast_time(run_ns)

    def show_graph(self, published: Connections, subscribed: Connections) -> None:
        """Show who publishes what, and who subscribes to what.

        Args:
            published: names of modules by topic.
            subscribed: likewise.
        """
        graph = self._foxglove.ConnectionGraph()
        for topic, modules in published.items():
            graph.set_published_topic(topic, sorted(modules))
        for topic, modules in subscribed.items():
            graph.set_subscribed_topic(topic, sorted(modules))
        for service in self._options.services:
            graph.set_advertised_service(service, [SERVICE_PROVIDER])
        self._server.publish_connection_graph(graph)

    # -- called by the SDK, in its threads ----------------------------------------------------------------

    def on_client_advertise(self, client: Any, channel: Any) -> None:
        """Note a client's channel, or that it came through the door."""
        if channel.id == GREETING_CHANNEL and channel.topic.startswith(self._options.greeting_topic):
            with self._lock:
                number = int(channel.topic.removeprefix(self._options.greeting_topic))
                self._clients.setdefault(client.id, number)
        elif self._is_guest(client):
            with self._lock:
                if sum(one == client.id for one, _ in self._announced) < MAX_CLIENT_CHANNELS:
                    self._announced[client.id, channel.id] = self._noted(channel)

    def on_client_unadvertise(self, client: Any, client_channel_id: int) -> None:
        """Forget a client's channel; the door's is the last, when the client has gone."""
        with self._lock:
            self._announced.pop((client.id, client_channel_id), None)
            if client_channel_id == GREETING_CHANNEL:
                self._clients.pop(client.id, None)

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Note a reader."""
        if self._is_guest(client):
            with self._lock:
                self._readers.setdefault(channel.id, set()).add(client.id)
                self._new_readers.add(channel.id)
            self._wake()

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        """Forget a reader."""
        with self._lock:
            self._readers.get(channel.id, set()).discard(client.id)

    def on_message_data(self, client: Any, client_channel_id: int, data: bytes) -> None:
        """Take a message of a client."""
        if not self._is_guest(client):
            return
        announced = self._announced.get((client.id, client_channel_id), ClientChannel("", "", ""))
        if len(data) > self._options.max_message_bytes:
            self.oversized += 1
        else:
            age_s = self._age_s(self._clients.get(client.id, 0))
            self._put(FromClient(announced, data, self._now_ns(), age_s))

    def on_get_parameters(self, client: Any, names: list[str], _request: str | None = None) -> list[Any]:
        """Return parameters; without names, all."""
        if not self._is_guest(client):
            return []
        known = self.parameters
        return [self._parameter(name, known[name]) for name in names or known if name in known]

    def on_set_parameters(self, client: Any, wishes: list[Any], _request: str | None = None) -> list[Any]:
        """Take wishes; the answer has the present values, and the new ones follow when modules have them."""
        if not self._is_guest(client):
            return []
        for wish in wishes:
            self._put(ParameterWish(wish.name, wish.get_value()))
        return self.on_get_parameters(client, [wish.name for wish in wishes])

    def on_parameters_subscribe(self, _names: list[str]) -> None:
        """Do nothing: changed parameters are published to those who want them."""

    def on_parameters_unsubscribe(self, _names: list[str]) -> None:
        """Do nothing."""

    def on_asset(self, uri: str) -> bytes:
        """Return a file of a package.

        Raises:
            FileNotFoundError: there is none that clients may read; the text says why.
        """
        parts = urlsplit(uri)
        packages = self._options.assets
        if parts.scheme != "package" or parts.netloc not in packages:
            known = ", ".join(f"package://{name}/" for name in packages)
            raise FileNotFoundError(
                f"this robot has only files of {known}"
                if known
                else "this robot offers no files: its profile sets no `assets`"
            )
        folder = packages[parts.netloc]
        try:
            path = (folder / unquote(parts.path).lstrip("/")).resolve()
            is_inside = path.is_relative_to(folder.resolve()) and path.is_file()
            if is_inside and path.stat().st_size <= MAX_ASSET_BYTES:
                return path.read_bytes()
        except (OSError, ValueError):
            pass
        raise FileNotFoundError(f"package://{parts.netloc}/ has no such file, or it is too large")

    def on_service(self, request: Any) -> bytes:
        """Hand a call over, and return the module's answer.

        Raises:
            PermissionError: the client did not come through the door.
            OverflowError: too much waits for the module.
            TimeoutError: the module did not answer.
        """
        if request.client_id not in self._clients:
            self.is_breached = True
            raise PermissionError("connect with the robot's token")
        call = ServiceCall(request.service_name, request.payload, self._now_ns())
        if not self._put(call):
            raise OverflowError("too much waits for the robot")
        return call.wait()

    # -- inside ------------------------------------------------------------------------------------------

    def _noted(self, channel: Any) -> ClientChannel:
        """Return what is kept of a client's channel; its schema only where the robot may need it."""
        announced = ClientChannel(channel.topic, channel.schema_name, channel.encoding)
        schema = channel.schema
        kept_bytes = sum(len(one.schema or b"") for one in self._announced.values())
        if channel.topic not in self._options.foreign_topics:
            return announced
        if schema and (len(schema) > MAX_TEXT_BYTES or kept_bytes + len(schema) > MAX_SCHEMA_BYTES):
            schema = None
        return announced._replace(schema_encoding=channel.schema_encoding or "", schema=schema)

    def _is_guest(self, client: Any) -> bool:
        """Whether a client came through the door; one that did not ends the server."""
        if client.id in self._clients:
            return True
        self.is_breached = True
        self._wake()
        return False

    def _put(self, arrived: Arrived) -> bool:
        with self._lock:
            has_room = (
                len(self._waiting) < MAX_WAITING and self._waiting_bytes + _size(arrived) <= MAX_WAITING_BYTES
            )
            if has_room:
                self._waiting.append(arrived)
                self._waiting_bytes += _size(arrived)
            else:
                self.overflowed += 1
        self._wake()
        return has_room

    def _parameter(self, name: str, value: object) -> Any:
        return self._foxglove.websocket.Parameter(name, value=value)

    def _service(self, name: str, has_bool: bool) -> Any:
        sdk = self._foxglove.websocket

        def message(part: str, text: str) -> Any:
            schema = self._foxglove.Schema(name=f"{kind}_{part}", encoding=ROS2MSG, data=text.encode())
            return sdk.MessageSchema(encoding=CDR, schema=schema)

        kind = f"std_srvs/srv/{'SetBool' if has_bool else 'Trigger'}"
        schema = sdk.ServiceSchema(
            kind,
            request=message("Request", SET_BOOL if has_bool else ""),
            response=message("Response", RESPONSE),
        )
        return sdk.Service(name, schema=schema, handler=self.on_service)


def _is_worth_telling(record: logging.LogRecord) -> bool:
    """Return whether a line of the SDK is kept: apps close connections without a word, which is no error."""
    return not record.getMessage().startswith("Error receiving from client")


def _size(arrived: Arrived) -> int:
    return 0 if isinstance(arrived, ParameterWish) else len(arrived.data)
