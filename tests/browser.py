"""A headless Chromium that opens a page, is sent keys, and is asked what it shows.

It is driven through its pipe (the DevTools protocol), so that no driver has to be installed.
"""

import base64
import fcntl
import json
import os
import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import pytest

CHROMIUM: Final = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))),
    None,
)
"""Command of the browser; None where there is none."""

needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")

_KEYS: Final = {"Tab": 9, "ArrowRight": 39, "ArrowLeft": 37, "ArrowDown": 40, "Space": 32}


class Page:
    """One open page."""

    def __init__(self, send: int, receive: int) -> None:
        self._send, self._receive = send, receive
        self._number, self._rest = 0, b""
        self._session: str | None = None
        self.reported: list[str] = []
        (target,) = [
            t["targetId"]
            for t in self._ask("Target.getTargets")["targetInfos"]
            if t["type"] == "page"
        ]
        asked = {"targetId": target, "flatten": True}
        self._session = self._ask("Target.attachToTarget", **asked)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._ask(f"{domain}.enable")
        # Else no field of the page knows that it has the focus.
        self._ask("Emulation.setFocusEmulationEnabled", enabled=True)

    def open(self, path: Path, width: int = 1280, height: int = 900) -> None:
        """Open a file and wait until it is laid out."""
        self._ask("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=1, mobile=False)  # fmt: skip
        self.reported.clear()
        self._ask("Page.navigate", url=path.resolve().as_uri())
        self.ask("new Promise(done => document.readyState == 'complete' ? done() : "
                 "addEventListener('load', done))")  # fmt: skip

    def ask(self, expression: str) -> Any:
        """Value of a JavaScript expression in the page."""
        found = self._ask("Runtime.evaluate", expression=expression, returnByValue=True,
                          awaitPromise=True)  # fmt: skip
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def press(self, key: str, times: int = 1) -> None:
        """Press a key and let go."""
        text = {"text": " "} if key == "Space" else {}
        code = {"windowsVirtualKeyCode": _KEYS[key], "code": key,
                "key": " " if key == "Space" else key}  # fmt: skip
        for _ in range(times):
            self._ask("Input.dispatchKeyEvent", type="keyDown", **code, **text)
            self._ask("Input.dispatchKeyEvent", type="keyUp", **code)

    def write(self, text: str) -> None:
        """Write a text into the field that has the focus."""
        self._ask("Input.insertText", text=text)

    def media(self, kind: str = "screen", scheme: str = "light") -> None:
        """Show the page as it is printed, or to a reader who prefers a dark one."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self._ask("Emulation.setEmulatedMedia", media=kind, features=features)

    def picture(self, path: Path) -> None:
        """Write what is to be seen."""
        path.write_bytes(base64.b64decode(self._ask("Page.captureScreenshot")["data"]))

    def accessible(self) -> list[dict[str, Any]]:
        """What a screen reader reads, in the order in which it is read."""
        nodes: list[dict[str, Any]] = self._ask("Accessibility.getFullAXTree")["nodes"]
        known = {node["nodeId"]: node for node in nodes}
        waiting, read = [nodes[0]], []
        while waiting:
            node = waiting.pop()
            read.append(node)
            waiting += [known[k] for k in reversed(node.get("childIds", ())) if k in known]
        return [node for node in read if not node["ignored"]]

    def pdf(self) -> bytes:
        """The page as it is printed."""
        return base64.b64decode(self._ask("Page.printToPDF", printBackground=True)["data"])

    def _ask(self, method: str, **given: Any) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": given}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._send, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                found: dict[str, Any] = answer["result"]
                return found
            if answer.get("method") in {"Log.entryAdded", "Runtime.exceptionThrown"}:
                self.reported.append(json.dumps(answer["params"]))
            if answer.get("method") == "Network.requestWillBeSent":
                self.reported.append(answer["params"]["request"]["url"][:200])

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            piece = os.read(self._receive, 1 << 20)
            assert piece, "the browser has ended"
            self._rest += piece
        message, _, self._rest = self._rest.partition(b"\0")
        found: dict[str, Any] = json.loads(message)
        return found


@contextmanager
def browser(folder: Path, *switches: str) -> Iterator[Page]:
    """A browser with one empty page; its profile lies in a folder."""
    to_read, send = _pipe()
    receive, to_write = _pipe()
    command = [
        *(str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu"),
        *("--remote-debugging-pipe", f"--user-data-dir={folder}", *switches, "about:blank"),
    ]
    # It reads from 3 and writes to 4.
    files = [
        (os.POSIX_SPAWN_DUP2, to_read, 3),
        (os.POSIX_SPAWN_DUP2, to_write, 4),
        (os.POSIX_SPAWN_OPEN, 2, os.devnull, os.O_WRONLY, 0),
    ]
    running = os.posix_spawn(command[0], command, os.environ, file_actions=files)
    os.close(to_read)
    os.close(to_write)
    try:
        yield Page(send, receive)
    finally:
        os.kill(running, signal.SIGTERM)
        os.waitpid(running, 0)
        os.close(send)
        os.close(receive)


def _pipe() -> list[int]:
    """Both ends of a pipe, with numbers that no child takes for its own."""
    ends = os.pipe()
    moved = [fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 10) for end in ends]
    for end in ends:
        os.close(end)
    return moved
