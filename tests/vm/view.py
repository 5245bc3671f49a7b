"""`gimbald view` beside a daemon with a real camera driver and loopback: who opens the camera, pictures, settings, the file.

In the virtual machine; arguments: the program.
"""
import json
import os
import subprocess
import sys
import time
import urllib.request

from rig import Camera, Daemon, Report, camera_appears, loopback, until

PROGRAM = sys.argv[1]
FILE = "/tmp/gimbald-view.toml"
report, out = Report(), loopback()
Camera.move()
with open(FILE, "w") as file:
    file.write(f'# mine\n[camera]\ndevice = "vivid" # the test camera\nwidth = 640\nheight = 360\n[output]\ndevice = "{out}"\nlinger_s = 1\n')


class Page:
    """The page as a program sees it."""

    def __init__(self, *arguments):
        self.process = subprocess.Popen([PROGRAM, "view", "--no-browser", *arguments], stdout=subprocess.PIPE, text=True)
        self.address = self.process.stdout.readline().strip()
        self.seen = 0

    def get(self, what):
        with urllib.request.urlopen(self.address + what, timeout=30) as answer:
            return answer.status, answer.read()

    def post(self, what, text):
        headers = {"Origin": self.address.rsplit("/", 2)[0]}
        request = urllib.request.Request(self.address + what, text.encode(), headers, method="POST")
        with urllib.request.urlopen(request, timeout=30) as answer:
            return json.load(answer)

    def state(self):
        return json.loads(self.get("state")[1])

    def picture(self):
        """The next picture's description and JPEG, or nothing."""
        status, body = self.get(f"preview?seen={self.seen}")
        if status == 204:
            return None
        size = int.from_bytes(body[:4], "little")
        head = json.loads(body[4:4 + size])
        self.seen = head["number"]
        return head, body[4 + size:]

    def pictures(self, seconds):
        end, found = time.monotonic() + seconds, []
        while time.monotonic() < end:
            found += filter(None, [self.picture()])
        return found

    def close(self):
        self.process.terminate()
        return self.process.wait(10)


daemon = Daemon(PROGRAM, out)
daemon.process = subprocess.Popen([PROGRAM, "run", "--config", FILE], stdout=open(daemon.log, "ab"), stderr=subprocess.STDOUT)
report.check("the daemon runs", until(20, lambda: "gimbald" in daemon.said() or daemon.alive()) and camera_appears(out))
page = Page()
report.check(f"the page has an address on the loopback interface ({page.address[:20]}...)", page.address.startswith("http://127.0.0.1:"))
time.sleep(2)
report.check("no page is open: the camera is closed", not Camera.is_open())
report.check("an open page opens it, and gets pictures", until(20, lambda: page.picture() is not None) and Camera.is_open())
page.pictures(3)
pictures = page.pictures(10)
rate = len(pictures) / 10
report.check(f"{rate:.1f} pictures a second", 5 <= rate <= 15)
largest = max((len(jpeg) for _, jpeg in pictures), default=0)
report.check(f"they are small JPEG pictures ({largest} bytes at most)", all(jpeg[:2] == b"\xff\xd8" for _, jpeg in pictures) and largest < 300_000)
report.check("that differ", len({jpeg for _, jpeg in pictures}) > len(pictures) / 2)
frames = [frame["n"] for head, _ in pictures for frame in head["frames"]]
report.check("with every frame's numbers", len(set(frames)) > 150)
status = page.state()["state"]["status"]
report.check(f"the status counts the page: {status['pipewire']}", status["pipewire"]["pages"] == 1 and status["watched"])
said = subprocess.run([PROGRAM, "status"], capture_output=True, text=True).stdout
report.check("and so does `gimbald status`", "1 page of `gimbald view`" in said)
report.say(f"{status['fps']:.1f} fps, latency {status['latency_ms']}, drops {status['drops']}")
report.check("a setting reaches the daemon", page.post("set", "smooth.strength=0.4")["ok"]
             and page.state()["settings"]["smooth.strength"] == "0.4")
report.check("one that needs a restart is refused", "restart" in page.post("set", "smooth.lookahead_ms=100")["error"])
written = page.post("write", "smooth.strength=0.4\nsmooth.lookahead_ms=100")
with open(FILE) as file:
    text = file.read()
report.check(f"both are written into the daemon's own file: {written.get('path')}", written["ok"] and written["path"] == FILE
             and "# mine" in text and "# the test camera" in text and "strength = 0.4" in text and "lookahead_ms = 100" in text)
report.check("which is right", subprocess.run([PROGRAM, "check", FILE], capture_output=True).returncode == 0)
other = Page()
report.check("two pages at once", until(20, lambda: other.picture() is not None and page.picture() is not None)
             and page.state()["state"]["status"]["pipewire"]["pages"] == 2)
other.close()
report.check("without requests, the camera is closed", until(20, lambda: not Camera.is_open()))
report.check("and opened again", until(20, lambda: page.picture() is not None))
daemon.kill()
daemon.process = subprocess.Popen([PROGRAM, "run", "--config", FILE], stdout=open(daemon.log, "ab"), stderr=subprocess.STDOUT)
report.check("the page outlives a daemon that is killed", until(30, lambda: page.picture() is not None))
report.check("the page ends on SIGTERM", page.close() == 0)
report.check("and so does the daemon", daemon.stop() == 0)
report.end()
