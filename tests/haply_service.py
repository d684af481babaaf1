"""A mock of Haply's Inverse Service, from its documented messages; as a program, for the benchmark."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Callable

from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve


def vector(axes: str, *values: float) -> dict[str, float]:
    return dict(zip(axes, values, strict=True))


class HaplyService:
    """One Inverse3 and one wireless VerseGrip. It answers each message, and keeps the forces [N]."""

    def __init__(self, port: int = 0) -> None:
        self.position, self.orientation = (0.0, 0.0, 0.005), (1.0, 0.0, 0.0, 0.0)  # [m]; w, x, y, z
        self.buttons = {"a": False, "b": False, "c": False}
        self.forces: list[tuple[float, ...]] = []
        self.delay, self.answers = 0.0, 1  # of each answer [s]; to each message
        self.change: Callable[[dict], object] = lambda message: message  # to an object, text or bytes
        self._connection: ServerConnection | None = None
        self._closed = threading.Event()
        self._server = serve(self._talk, "127.0.0.1", port, compression=None)
        self.port = self._server.socket.getsockname()[1]
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def message(self) -> dict:
        arm = {"device_id": "049D", "state": {
            "cursor_position": vector("xyz", *self.position), "cursor_velocity": vector("xyz", 0.0, 0.0, 0.0),
            "current_cursor_force": vector("xyz", 0.0, 0.0, 0.0), "control_mode": "idle",
        }, "status": {"calibrated": True, "in_use": False, "power_supply": True, "ready": True}}  # fmt: skip
        grip = {"device_id": "61548", "state": {
            "orientation": vector("wxyz", *self.orientation), "buttons": self.buttons, "hall": 0,
        }}  # fmt: skip
        return {"session_id": 7, "inverse3": [arm], "verse_grip": [], "wireless_verse_grip": [grip]}

    def drop(self) -> None:
        """Cuts the connection."""
        self._connection.socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._closed.set()
        self._server.shutdown()

    def _talk(self, connection: ServerConnection) -> None:
        self._connection = connection
        try:
            self._answer(connection)
            while True:
                (arm,) = json.loads(connection.recv())["inverse3"]
                assert arm["device_id"] == "049D"
                force = arm["commands"]["set_cursor_force"]["vector"]
                self.forces.append(tuple(force[axis] for axis in "xyz"))
                for _ in range(self.answers):
                    self._answer(connection)
        except ConnectionClosed:
            pass

    def _answer(self, connection: ServerConnection) -> None:
        self._closed.wait(self.delay)
        answer = self.change(self.message())
        connection.send(answer if isinstance(answer, str | bytes) else json.dumps(answer))


if __name__ == "__main__":
    print(HaplyService().port, flush=True)
    threading.Event().wait()
