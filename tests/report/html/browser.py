"""A headless Chromium, driven by the devtools protocol, for tests of pages."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import subprocess
import time

import websocket

PROGRAM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
MISSING = "no Chromium is installed (apt-get install chromium)"
START_S = 240.0


class Browser:
    """One page of a browser of its own; what it asked for and what it complained of is kept."""

    def __init__(self, profile, width=1280, height=900):
        self.requests, self.complaints, self.number = [], [], 0
        words = [
            PROGRAM, "--headless=new", "--disable-gpu", "--no-sandbox", "--remote-debugging-port=0",
            f"--user-data-dir={profile}", "--no-first-run", "--disable-dev-shm-usage",
            "--remote-allow-origins=*", "--hide-scrollbars", "--disable-renderer-backgrounding",
            "--disable-background-timer-throttling", "--disable-backgrounding-occluded-windows",
            f"--window-size={width},{height}", "about:blank",
        ]  # fmt: skip
        self.process = subprocess.Popen(
            words, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env={**os.environ}
        )
        try:
            self.socket = websocket.create_connection(self._page(profile), timeout=START_S)
        except BaseException:
            self.close()
            raise
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        self.resize(width, height)

    def _page(self, profile):
        """The address of the only page."""
        port = profile / "DevToolsActivePort"
        end = time.monotonic() + START_S
        while time.monotonic() < end:
            if port.exists() and len(port.read_text().split()) == 2:
                number, browser = port.read_text().split()
                self.socket = websocket.create_connection(f"ws://127.0.0.1:{number}{browser}")
                targets = self.call("Target.getTargets")["targetInfos"]
                self.socket.close()
                page = next((one for one in targets if one["type"] == "page"), None)
                if page is not None:
                    return f"ws://127.0.0.1:{number}/devtools/page/{page['targetId']}"
            if self.process.poll() is not None:
                raise RuntimeError(f"Chromium ended with {self.process.returncode}")
            time.sleep(0.05)
        raise RuntimeError("Chromium does not answer")

    def call(self, method, **parameters):
        """One command of the protocol; what happened meanwhile is noted."""
        self.number += 1
        number = self.number
        self.socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self.socket.recv())
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(answer["error"])
                return answer["result"]
            if "method" in answer:
                self._note(answer)

    def _note(self, event):
        parameters = event.get("params", {})
        if event["method"] == "Network.requestWillBeSent":
            self.requests.append(parameters["request"]["url"])
        elif event["method"] == "Runtime.exceptionThrown":
            self.complaints.append(parameters["exceptionDetails"])
        elif event["method"] == "Log.entryAdded":
            self.complaints.append(parameters["entry"])
        elif event["method"] == "Runtime.consoleAPICalled" and parameters["type"] in {
            "error", "warning", "assert",
        }:  # fmt: skip
            self.complaints.append(parameters)

    def resize(self, width, height):
        """The size of the window, in pixels."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height,
            deviceScaleFactor=1, mobile=width < 600,
        )  # fmt: skip

    def open(self, path):
        """Load a page from a file and wait until it says that it is drawn."""
        self.call("Page.navigate", url=path.resolve().as_uri())
        self.until("document.body && document.body.dataset.ready === 'true'")

    def until(self, condition):
        """Wait for something to hold in the page."""
        end = time.monotonic() + START_S
        while not self.run(condition):
            if time.monotonic() > end:
                raise RuntimeError(f"never: {condition}; {self.complaints}")
            time.sleep(0.05)

    def run(self, script):
        """The value of an expression; promises are awaited."""
        done = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in done:
            raise RuntimeError(done["exceptionDetails"])
        return done["result"].get("value")

    def press(self, key, code, text=""):
        """One key, as a keyboard sends it."""
        words = {"key": key, "code": key, "windowsVirtualKeyCode": code}
        self.call("Input.dispatchKeyEvent", type="keyDown", text=text, **words)
        self.call("Input.dispatchKeyEvent", type="keyUp", **words)

    def picture(self, path, *, whole=False):
        """A PNG of the window, or of the whole page."""
        shot = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(shot["data"]))

    def outside(self):
        """Requests for anything but the page itself and what stands in it."""
        return [url for url in self.requests if re.match(r"(file|data|blob|about):", url) is None]

    def close(self):
        """End the browser."""
        if hasattr(self, "socket"):
            self.socket.close()
        self.process.terminate()
        self.process.wait(30)
