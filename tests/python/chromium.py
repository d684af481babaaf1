"""A headless Chromium, driven through its DevTools pipe, without a port or a package."""

import base64
import io
import json
import os
import select
import shutil
import subprocess
import sys
import time

import numpy as np
from PIL import Image

# Chromium reads descriptor 3 and writes 4.
_LAUNCH = """
import fcntl, os, sys
ends = [fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in sys.argv[1:3]]
for number, end in zip((3, 4), ends):
    os.dup2(end, number)
os.execv(sys.argv[3], sys.argv[3:])
"""
_FLAGS = [
    "--headless=new", "--remote-debugging-pipe", "--no-first-run", "--no-sandbox", "--disable-extensions",
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
        self.console = []
        read, chromium_write = os.pipe()
        chromium_read, write = os.pipe()
        self._read, self._write = read, write
        self._process = subprocess.Popen(
            [sys.executable, "-c", _LAUNCH, str(chromium_read), str(chromium_write), chromium_path(), *_FLAGS,
             f"--user-data-dir={folder}", f"--window-size={size[0]},{size[1]}", *flags, "about:blank"],
            pass_fds=(chromium_read, chromium_write), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(chromium_read)
        os.close(chromium_write)
        self._bytes, self._number, self._session = b"", 0, None
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(target for target in targets if target["type"] == "page")
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
        self.close()

    def close(self):
        self._session = None
        try:
            self.call("Browser.close")
            self._process.wait(10)
        except (OSError, EOFError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        os.close(self._read)
        os.close(self._write)

    def call(self, method, seconds=60.0, **parameters):
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._write, data) :]
        until = time.monotonic() + seconds
        while True:
            answer = self._receive(until)
            if answer.get("id") == self._number:
                assert "error" not in answer, (method, answer)
                return answer["result"]
            self._hear(answer)

    def _receive(self, until):
        while b"\0" not in self._bytes:
            left = until - time.monotonic()
            if left <= 0 or not select.select([self._read], [], [], left)[0]:
                raise TimeoutError("Chromium does not answer")
            more = os.read(self._read, 1 << 20)
            if not more:
                raise EOFError("Chromium has ended")
            self._bytes += more
        one, self._bytes = self._bytes.split(b"\0", 1)
        return json.loads(one)

    def _hear(self, event):
        told, of = event.get("params", {}), event.get("method")
        if of == "Runtime.consoleAPICalled":
            words = [str(part.get("value", part.get("description"))) for part in told["args"]]
            self.console.append((told["type"], " ".join(words)))
        elif of == "Log.entryAdded":
            self.console.append((told["entry"]["level"], told["entry"]["text"]))
        elif of == "Runtime.exceptionThrown":
            self.console.append(("error", str(told["exceptionDetails"])))

    def load(self, url):
        self.call("Page.navigate", url=url)

    def value(self, expression):
        """Value of JavaScript in the page."""
        got = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in got, got
        return got["result"].get("value")

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
