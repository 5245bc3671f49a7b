"""Chromium as a call app: it lists the camera, gets frames, keeps its track through a restart, a kill and an unplugging.

In the virtual machine, with Chromium in it; argument: the program.
"""
import http.server
import json
import shutil
import subprocess
import sys
import threading
import time

from rig import Camera, Daemon, Manager, Report, camera_appears, loopback, now, until

PAGE = b"""<!doctype html><title>call</title><video id=v muted playsinline></video><script>
const tell = what => fetch('/told', {method: 'POST', body: JSON.stringify(what)});
(async () => {
  try {
    // Names are told only to a page that was let use a camera, whichever.
    (await navigator.mediaDevices.getUserMedia({video: true})).getTracks().forEach(track => track.stop());
    const cameras = (await navigator.mediaDevices.enumerateDevices()).filter(d => d.kind == 'videoinput');
    const listed = cameras.map(d => d.label);
    const chosen = cameras.find(d => !d.label.startsWith('vivid'));
    const stream = await navigator.mediaDevices.getUserMedia({video: {deviceId: {exact: chosen.deviceId}}});
    const track = stream.getVideoTracks()[0];
    await tell({event: 'track', label: track.label, listed, settings: track.getSettings()});
    track.onended = () => tell({event: 'ended'});
    const video = document.getElementById('v');
    video.srcObject = stream;
    await video.play();
    const canvas = document.createElement('canvas');
    const look = async () => {
      [canvas.width, canvas.height] = [64, 48];
      const context = canvas.getContext('2d', {willReadFrequently: true});
      context.drawImage(video, 0, 0, 64, 48);
      const data = context.getImageData(0, 0, 64, 48).data;
      let mean = 0, sum = 0;
      for (let i = 0; i < data.length; i += 4) { mean += data[i + 1]; sum = (sum * 31 + data[i] + data[i + 1]) % 1000003; }
      await tell({event: 'frame', mean: mean * 4 / data.length, sum, width: video.videoWidth});
      video.requestVideoFrameCallback(look);
    };
    video.requestVideoFrameCallback(look);
  } catch (error) { await tell({event: 'error', name: error.name, message: error.message}); }
})();
</script>"""
events = []


class Page(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(PAGE)

    def do_POST(self):
        events.append((now(), json.loads(self.rfile.read(int(self.headers["Content-Length"])))))
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_):
        pass


report, out, manager = Report(), loopback(), Manager()
if not shutil.which("chromium"):
    sys.exit("SKIPPED: no Chromium here")
server = http.server.ThreadingHTTPServer(("127.0.0.1", 8000), Page)
threading.Thread(target=server.serve_forever, daemon=True).start()
Camera.move()
daemon = Daemon(sys.argv[1], out, "camera.width=640", "camera.height=480", "camera.fps=30",
                env={"NOTIFY_SOCKET": manager.path}).start()
report.check("the loopback becomes a camera", camera_appears(out))
browser = subprocess.Popen(
    ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
     "--disable-component-update", "--disable-sync", "--disable-extensions", "--disable-dev-shm-usage",
     "--user-data-dir=/tmp/profile", "--use-fake-ui-for-media-stream", "--autoplay-policy=no-user-gesture-required",
     "http://localhost:8000/"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def live_since(begun, different=5):
    return len({what["sum"] for came, what in list(events) if came > begun and what["event"] == "frame" and what["mean"] > 60}) >= different


def seen(event):
    return [what for _, what in list(events) if what["event"] == event]


def live(what, patience=60):
    begun = now()
    report.check(what, until(patience, lambda: live_since(begun) or seen("error")) and not seen("error"))
    report.say(f"      after {now() - begun:.2f} s; {len(seen('frame'))} frames seen, track ended {len(seen('ended'))} times")


live("the page shows a live picture", 120)
for track in seen("track"):
    report.say("     ", track)
label = open(f"/sys/class/video4linux/{out[5:]}/name").read().strip()
report.check(f"getUserMedia lists {label}, and gives it", any(label in track["listed"] and track["label"] == label for track in seen("track")))
time.sleep(3)
daemon.stop()
time.sleep(0.3)
daemon.start()
live("after a restart of the daemon")
daemon.kill()
time.sleep(2)
daemon.start()
live("after a kill, and two seconds without a daemon")
Camera.unplug()
time.sleep(15)
report.check("the track lives 15 s without the camera", not seen("ended"))
Camera.plug()
live("after that")
report.check("the track never ended", not seen("ended") and not seen("error"))
for error in seen("error"):
    report.say("     ", error)
browser.kill()
browser.wait()
report.check("the camera is closed when the browser is gone", until(15, lambda: not Camera.is_open()))
report.check("it stops", daemon.stop() == 0)
if report.failed:
    print(daemon.said()[-20000:])
report.end()
