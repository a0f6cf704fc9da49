"""A headless Chromium that opens a page, clicks and drags in it, and tells of every request and error; spoken to
through a pipe in its own protocol (Chrome DevTools Protocol), so that no other package is needed."""

import base64
import fcntl
import json
import os
import select
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, sleep
from typing import Any

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
ORDERS, ANSWERS = 3, 4  # the descriptors that it reads from and writes to
ABOVE = 10  # where ours are, so that laying one does not end the other
PATIENCE = 120.0  # s, on a busy machine
OPTIONS = (
    "--headless=new", "--no-sandbox", "--disable-gpu-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--no-first-run", "--disable-background-networking", "--disable-component-update", "--window-size=700,600",
    "--remote-debugging-pipe",
)  # fmt: skip


class Browser:
    """A page in a browser: `requests` are the addresses that it asked for, `errors` what it complained of."""

    def __init__(self, send: int, receive: int) -> None:
        self._send, self._receive = send, receive
        self._number, self._buffer, self._session = 0, b"", ""
        self._answers: dict[int, dict[str, Any]] = {}
        self.requests: list[str] = []
        self.errors: list[str] = []

    def attach(self) -> None:
        """Open an empty page and listen to it."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **arguments: Any) -> dict[str, Any]:
        """Ask for something and wait for the answer."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": arguments}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._send, json.dumps(message).encode() + b"\0")
        end = monotonic() + PATIENCE
        while self._number not in self._answers:
            self._read(end - monotonic())
        answer = self._answers.pop(self._number)
        assert "error" not in answer, f"{method}: {answer['error']}"
        result: dict[str, Any] = answer["result"]
        return result

    def _read(self, patience: float) -> None:
        ready, _, _ = select.select([self._receive], [], [], max(patience, 0.0))
        assert ready, "the browser does not answer"
        heard = os.read(self._receive, 1 << 20)
        assert heard, "the browser has ended"
        self._buffer += heard
        *whole, self._buffer = self._buffer.split(b"\0")
        for text in whole:
            message = json.loads(text)
            if "id" in message:
                self._answers[message["id"]] = message
            else:
                self._hear(message["method"], message["params"])

    def _hear(self, method: str, said: dict[str, Any]) -> None:
        if method == "Network.requestWillBeSent":
            self.requests.append(said["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            self.errors.append(str(said["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and said["type"] in ("error", "assert"):
            self.errors.append(str(said["args"]))
        elif method == "Log.entryAdded" and said["entry"]["level"] == "error":
            self.errors.append(str(said["entry"]))

    def open(self, path: Path) -> None:
        """Open a file and wait until its scripts have run."""
        self.call("Page.navigate", url=path.resolve().as_uri())
        self.wait("document.readyState === 'complete'")

    def ask(self, expression: str) -> Any:
        """Return the value of an expression in the page."""
        done = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in done, done["exceptionDetails"]
        return done["result"].get("value")

    def wait(self, condition: str) -> None:
        """Wait until an expression holds in the page."""
        end = monotonic() + PATIENCE
        while not self.ask(f"Boolean({condition})"):
            assert monotonic() < end, f"{condition} does not come true"
            sleep(0.1)

    def middle(self, selector: str) -> tuple[float, float]:
        """Scroll to an element and return its middle in the window."""
        self.ask(f"document.querySelector({selector!r}).scrollIntoView({{block: 'center'}})")
        sleep(0.3)
        box = self.ask(f"(() => {{ const b = document.querySelector({selector!r}).getBoundingClientRect();"
                       " return [b.x + b.width / 2, b.y + b.height / 2]; })()")  # fmt: skip
        return float(box[0]), float(box[1])

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """Move, press or release the mouse."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=more.pop("button", "left"), **more)

    def drag(self, selector: str, across: float, down: float) -> None:
        """Drag from the middle of an element by so many pixels."""
        x, y = self.middle(selector)
        self.mouse("mouseMoved", x, y, button="none")
        self.mouse("mousePressed", x, y, clickCount=1, buttons=1)
        for share in (0.25, 0.5, 0.75, 1.0):
            self.mouse("mouseMoved", x + share * across, y + share * down, buttons=1)
            sleep(0.05)
        self.mouse("mouseReleased", x + across, y + down, clickCount=1)
        sleep(0.3)

    def click(self, selector: str) -> None:
        """Click the middle of an element."""
        x, y = self.middle(selector)
        self.mouse("mousePressed", x, y, clickCount=1, buttons=1)
        self.mouse("mouseReleased", x, y, clickCount=1)

    def press(self, selector: str, key: str, code: int) -> None:
        """Press a key in an element."""
        self.ask(f"document.querySelector({selector!r}).focus()")
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)

    def picture(self, path: Path) -> None:
        """Write what the window shows into a PNG file."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))


@contextmanager
def browser(folder: Path) -> Iterator[Browser]:
    """Start a browser whose profile is in a folder, and end it."""
    assert CHROMIUM is not None
    ours = [*os.pipe(), *os.pipe()]
    there, send, receive, back = (fcntl.fcntl(one, fcntl.F_DUPFD, ABOVE) for one in ours)
    for one in ours:
        os.close(one)

    def lay() -> None:
        os.dup2(there, ORDERS)
        os.dup2(back, ANSWERS)

    child = subprocess.Popen(
        [CHROMIUM, *OPTIONS, f"--user-data-dir={folder / 'profile'}"],
        pass_fds=(ORDERS, ANSWERS), preexec_fn=lay,  # noqa: PLW1509  the tests run no threads
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(there)
    os.close(back)
    try:
        page = Browser(send, receive)
        page.attach()
        yield page
    finally:
        child.terminate()
        child.wait(timeout=PATIENCE)
        os.close(send)
        os.close(receive)
