"""A headless Chromium, driven through its DevTools socket."""

import base64
import io
import itertools
import json
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

_FLAGS = [
    "--headless=new", "--remote-debugging-port=0", "--no-first-run", "--no-sandbox", "--disable-extensions",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
    # no other machine can be reached, and the page must still work
    "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",
]  # fmt: skip


def chromium_path():
    """Path of Debian's or another Chromium; None without."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Chromium:
    """One page. `console` keeps its log with all failed loads, such as requests to other machines."""

    def __init__(self, folder, *flags, size=(1280, 800)):
        connect = pytest.importorskip("websockets.sync.client", reason="needs the extra haply").connect
        self.console, self._numbers, self._session = [], itertools.count(1), None
        self._process = subprocess.Popen(
            [chromium_path(), *_FLAGS, f"--user-data-dir={folder}", f"--window-size={size[0]},{size[1]}", *flags, "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        file, until = Path(folder) / "DevToolsActivePort", time.monotonic() + 60.0
        while not (file.exists() and len(address := file.read_text().split()) == 2):
            assert time.monotonic() < until, "Chromium does not start"
            time.sleep(0.05)
        self._connection = connect(f"ws://127.0.0.1:{address[0]}{address[1]}", max_size=None)
        self._socket = self._connection.__enter__()
        page = next(
            target for target in self.call("Target.getTargets")["targetInfos"] if target["type"] == "page"
        )
        attached = self.call("Target.attachToTarget", targetId=page["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=size[0],
            height=size[1],
            deviceScaleFactor=1,
            mobile=False,
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._connection.__exit__(None, None, None)
        self._process.terminate()
        self._process.wait(20)

    def call(self, method, seconds=60.0, **parameters):
        number, until = next(self._numbers), time.monotonic() + seconds
        message = {"id": number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        self._socket.send(json.dumps(message))
        while (answer := json.loads(self._socket.recv(until - time.monotonic()))).get("id") != number:
            self._hear(answer)
        assert "error" not in answer, (method, answer)
        return answer["result"]

    def _hear(self, event):
        details, name = event.get("params", {}), event.get("method")
        if name == "Runtime.consoleAPICalled":
            words = [str(part.get("value", part.get("description"))) for part in details["args"]]
            self.console.append((details["type"], " ".join(words)))
        elif name == "Log.entryAdded":
            self.console.append((details["entry"]["level"], details["entry"]["text"]))
        elif name == "Runtime.exceptionThrown":
            self.console.append(("error", str(details["exceptionDetails"])))

    def load(self, url):
        self.call("Page.navigate", url=url)

    def value(self, expression):
        """Value of JavaScript in the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait(self, expression, seconds=60.0):
        """Waits until an expression is true; returns its value."""
        until = time.monotonic() + seconds
        while not (value := self.value(expression)):
            assert time.monotonic() < until, f"{expression} did not come true in {seconds:g} s"
            time.sleep(0.05)
        return value

    def box(self, selector):
        """x, y, width, height of an element."""
        return self.value(
            "(r => [r.x, r.y, r.width, "
            f"r.height])(document.querySelector({selector!r}).getBoundingClientRect())"
        )

    def mouse(self, kind, x, y, *, button="left", buttons=1, **more):
        self.call(
            "Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, button=button, buttons=buttons,
            clickCount=1, **more,
        )  # fmt: skip

    def click(self, x, y):
        self.mouse("Pressed", x, y)
        self.mouse("Released", x, y, buttons=0)

    def drag(self, start, stop, steps=10):
        """Drags with the left button."""
        self.mouse("Pressed", *start)
        for part in np.linspace(0, 1, steps + 1)[1:]:
            self.mouse("Moved", *(np.add(start, part * np.subtract(stop, start)).tolist()))
            time.sleep(0.02)
        self.mouse("Released", *stop, buttons=0)

    def screenshot(self):
        """The page's picture, (height, width, 3)."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)
