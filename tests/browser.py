"""A headless Chromium that is steered as a person would: real clicks and keys, through its own debugging protocol."""

import asyncio
import base64
import json
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from threading import Thread
from typing import Any, Self

import pytest

FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--remote-debugging-port=0",
         "--no-first-run", "--disable-background-networking", "--disable-dev-shm-usage")  # fmt: skip
SIXTY = 60.0
LONGEST = 7 * SIXTY  # s for one answer of the browser; longer than any test waits for a page


def chromium() -> str:
    """The browser of this machine; the test is skipped where there is none."""
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if found is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    return found


class Browser:
    """One tab. Use it in a ``with`` block."""

    def __init__(self, width: int = 1400, height: int = 1000, *, dark: bool = False) -> None:
        from websockets.asyncio.client import connect

        self._folder = tempfile.mkdtemp(prefix="armdyn-browser-")
        self._loop = asyncio.new_event_loop()
        self._process = subprocess.Popen(
            [chromium(), *FLAGS, f"--user-data-dir={self._folder}", f"--window-size={width},{height}", "about:blank"],
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        address = next(found[1] for line in self._process.stderr if (found := re.search(r"(ws://\S+)", line)))
        # What else it has to say is read by nobody, and must not fill the pipe.
        Thread(target=self._process.stderr.read, daemon=True).start()
        self._number, self._answers, self.errors = 0, {}, []
        self._session: str | None = None

        async def begin() -> None:
            self._socket = await connect(address, max_size=None)
            self._listening = asyncio.create_task(self._listen())

        self._loop.run_until_complete(begin())
        target = self._tell("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._tell("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime"):
            self._tell(f"{domain}.enable")
        self.resize(width, height)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self._tell("Emulation.setEmulatedMedia", features=[scheme])

    async def _listen(self) -> None:
        async for text in self._socket:
            message = json.loads(text)
            if message.get("id") in self._answers:
                self._answers.pop(message["id"]).set_result(message)
            elif message.get("method") == "Runtime.exceptionThrown":
                details = message["params"]["exceptionDetails"]
                self.errors.append(details.get("exception", {}).get("description") or details["text"])

    def _tell(self, method: str, **params: Any) -> dict[str, Any]:
        async def ask() -> dict[str, Any]:
            self._number += 1
            answer = self._answers[self._number] = self._loop.create_future()
            session = {} if self._session is None else {"sessionId": self._session}
            await self._socket.send(json.dumps({"id": self._number, "method": method, "params": params} | session))
            return await asyncio.wait_for(answer, LONGEST)

        message = self._loop.run_until_complete(ask())
        assert "error" not in message, message["error"]
        return message["result"]

    def resize(self, width: int, height: int) -> None:
        """As wide and high as a screen [px]."""
        self._tell("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def go(self, address: str) -> None:
        """Open a page."""
        self._tell("Page.navigate", url=address)

    def ask(self, expression: str) -> Any:
        """The value of a JavaScript expression; a promise is awaited."""
        found = self._tell("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def wait(self, expression: str, seconds: float = SIXTY) -> Any:
        """Wait until an expression is true; its value."""
        code = f"""new Promise((done, fail) => {{
            const end = performance.now() + {1000 * seconds};
            const look = () => {{
                let value; try {{ value = ({expression}); }} catch (error) {{ value = null; }}
                if (value) done(true);
                else if (performance.now() > end) done(null);
                else setTimeout(look, 20);
            }};
            look();
        }})"""
        for _ in range(3):  # a page that is loaded meanwhile ends what ran in the one before
            try:
                found = self._tell("Runtime.evaluate", expression=code, returnByValue=True, awaitPromise=True)
                break
            except AssertionError:
                continue
        value = found["result"].get("value")
        assert value, f"never came: {expression}; errors {self.errors}; {self.ask('document.body.innerText')[:600]}"
        return value

    def click(self, selector: str) -> None:
        """Press the left button of the mouse on an element, where it can be seen."""
        x, y = self.ask(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
            " e.scrollIntoView({ block: 'center', behavior: 'instant' }); const b = e.getBoundingClientRect();"
            " return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            button = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
            self._tell("Input.dispatchMouseEvent", type=kind, x=x, y=y, **button)

    def point(self, x: float, y: float) -> None:
        """Move the mouse to a place [px]."""
        self._tell("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)

    def drop(self, selector: str, files: list[Path]) -> None:
        """Choose files in an input for files."""
        root = self._tell("DOM.getDocument")["root"]["nodeId"]
        node = self._tell("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
        self._tell("DOM.setFileInputFiles", nodeId=node, files=[str(path) for path in files])

    def picture(self, path: Path, *, whole: bool = False) -> None:
        """What can be seen, or the whole page, as PNG."""
        found = self._tell("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(found["data"]))

    def close(self) -> None:
        """End the browser."""

        async def end() -> None:
            await self._socket.close()
            self._listening.cancel()

        self._loop.run_until_complete(end())
        self._loop.close()
        self._process.terminate()
        self._process.wait(10)
        shutil.rmtree(self._folder, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
