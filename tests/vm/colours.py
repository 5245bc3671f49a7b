"""Colour bars through every format of camera and every format of the loopback, as ffmpeg, GStreamer and Chromium show them.

In the virtual machine; arguments: the program, sizes as 640x480 (640x480 1280x720 1920x1080), and formats of the camera as MJPG or BGR3:
those are then tried at every size. Without them, every format that ffmpeg can put on a loopback is a camera at the first size, JPEG and
YUYV at the others. Each bar may be off by 3 of 255 in R, G and B.
"""
import http.server
import json
import os
import shutil
import subprocess
import sys
import threading
import time

from rig import Daemon, Report, camera_appears, identity_or_none, loopback, nodes, until

SIZES = [tuple(map(int, word.split("x"))) for word in sys.argv[2:] if word[0].isdigit()] or [(640, 480), (1280, 720), (1920, 1080)]
MOST_OFF = 3
PATIENCE = 120
# Bar n has red, green and blue where bits 0, 1 and 2 of n are set.
BARS = [tuple(255 * (bar >> bit & 1) for bit in range(3)) for bar in range(8)]
# The name that V4L2 has for each, and ffmpeg's for the samples that are made here and for what it makes of them. JPEG has full range, all
# others limited; each is BT.601.
CAMERAS = {
    "MJPG 4:2:2": ("yuvj422p", ["-c:v", "mjpeg", "-q:v", "2"]),
    "MJPG 4:2:0": ("yuvj420p", ["-c:v", "mjpeg", "-q:v", "2"]),
    "YUYV": ("yuyv422", ["-c:v", "rawvideo"]),
    "NV12": ("nv12", ["-c:v", "rawvideo"]),
    "YU12": ("yuv420p", ["-c:v", "rawvideo"]),
    "RGB3": ("rgb24", ["-c:v", "rawvideo"]),
    "BGR3": ("bgr24", ["-c:v", "rawvideo"]),
}
NAMED = [camera for camera in CAMERAS for word in sys.argv[2:] if camera.startswith(word)]
OUTPUTS = ("yuyv", "i420", "nv12")
report, out = Report(), loopback()
spare = next(path for path in nodes() if path != out and identity_or_none(path) == "v4l2 loopback")


def samples(layout, width, height):
    """A frame of the bars. They are an even number of pixels wide, so that no chroma sample is of two bars."""
    full = layout.startswith("yuvj")
    black, span, chroma_span = (0, 255, 255) if full else (16, 219, 224)
    colours = []
    for red, green, blue in BARS:
        luma = 0.299 * red + 0.587 * green + 0.114 * blue
        exact = (black + span * luma / 255, 128 + chroma_span * (blue - luma) / 1.772 / 255, 128 + chroma_span * (red - luma) / 1.402 / 255)
        colours.append(tuple(min(255, round(value)) for value in exact))
    bar = width // 8
    luma, u, v = (b"".join(bytes([colour[n]]) * (bar if n == 0 else bar // 2) for colour in colours) for n in range(3))
    pairs = b"".join(bytes(pair) for pair in zip(u, v))
    return {
        "rgb24": b"".join(bytes(colour) * bar for colour in BARS) * height,
        "bgr24": b"".join(bytes(colour[::-1]) * bar for colour in BARS) * height,
        "yuyv422": b"".join(bytes((colour[0], colour[1], colour[0], colour[2])) * (bar // 2) for colour in colours) * height,
        "nv12": luma * height + pairs * (height // 2),
        "yuv420p": luma * height + u * (height // 2) + v * (height // 2),
        "yuvj420p": luma * height + u * (height // 2) + v * (height // 2),
        "yuvj422p": luma * height + u * height + v * height,
    }[layout]


def worst(colours):
    """How far a reader's colours in the middle of each bar are off."""
    return max((abs(got - want) for shown, bar in zip(colours, BARS) for got, want in zip(shown, bar)), default=255)


def judge(what, colours):
    off = worst(colours)
    report.check(f"{what}: off by {off} at most", len(colours) == len(BARS) and off <= MOST_OFF)
    if off > MOST_OFF:
        report.say("     ", colours)


def middles(data, width, height, step, places):
    """The bars' colours in the last whole frame of `data`, of `step` bytes a pixel with R, G and B at these places."""
    size = width * height * step
    last = len(data) // size * size - size
    if last < 0:
        return []
    pixels = [last + (height // 2 * width + (2 * bar + 1) * width // 16) * step for bar in range(8)]
    return [tuple(data[at + place] for place in places) for at in pixels]


def read(what, width, height, arguments, step=3, places=(0, 1, 2)):
    if not shutil.which(arguments[0]):
        report.say(f"SKIPPED: {what}: {arguments[0]} is not installed")
        return
    end = time.monotonic() + PATIENCE
    while True:
        try:
            done = subprocess.run(arguments, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            report.check(f"{what}: did not end", False)
            return
        colours = middles(done.stdout, width, height, step, places)
        # Further off than any mistake in range or matrix: the picture is not there yet, what is seen is the placeholder.
        if done.returncode or worst(colours) < 100 or time.monotonic() > end:
            break
        time.sleep(1)
    judge(what, colours)
    if done.returncode:
        print(done.stderr.decode(errors="replace")[-600:])


PAGE = b"""<!doctype html><title>bars</title><video id=v muted playsinline></video><script>
const tell = what => fetch('/told', {method: 'POST', body: JSON.stringify(what)});
(async () => {
  try {
    (await navigator.mediaDevices.getUserMedia({video: true})).getTracks().forEach(track => track.stop());
    const cameras = (await navigator.mediaDevices.enumerateDevices()).filter(d => d.kind == 'videoinput');
    const chosen = cameras.find(d => d.label.startsWith(LABEL));
    const stream = await navigator.mediaDevices.getUserMedia(
      {video: {deviceId: {exact: chosen.deviceId}, width: {ideal: WIDTH}, height: {ideal: HEIGHT}}});
    const video = document.getElementById('v');
    video.srcObject = stream;
    await video.play();
    const canvas = document.createElement('canvas');
    let frames = 0;
    const look = async () => {
      if (++frames < 5) { video.requestVideoFrameCallback(look); return; }
      [canvas.width, canvas.height] = [video.videoWidth, video.videoHeight];
      const context = canvas.getContext('2d', {willReadFrequently: true});
      context.drawImage(video, 0, 0);
      const row = context.getImageData(0, canvas.height >> 1, canvas.width, 1).data;
      const bars = [...Array(8).keys()].map(n => [...row.slice(4 * ((2 * n + 1) * canvas.width >> 4), 4 * ((2 * n + 1) * canvas.width >> 4) + 3)]);
      // Until the last bar is bright it is the placeholder that is seen, at two frames a second.
      if (bars[7][1] < 150 && frames < 100) { video.requestVideoFrameCallback(look); return; }
      await tell({bars, size: [canvas.width, canvas.height]});
    };
    video.requestVideoFrameCallback(look);
  } catch (error) { await tell({error: error.name + ' ' + error.message}); }
})();
</script>"""
told = []


class Page(http.server.BaseHTTPRequestHandler):
    page = PAGE

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(Page.page)

    def do_POST(self):
        told.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_):
        pass


def browse(what, width, height):
    label = open(f"/sys/class/video4linux/{out[5:]}/name").read().strip()
    replaced = {b"LABEL": json.dumps(label).encode(), b"WIDTH": str(width).encode(), b"HEIGHT": str(height).encode()}
    Page.page = PAGE
    for word, by in replaced.items():
        Page.page = Page.page.replace(word, by)
    told.clear()
    browser = subprocess.Popen(
        ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync", "--disable-extensions", "--disable-dev-shm-usage",
         "--user-data-dir=/tmp/profile", "--use-fake-ui-for-media-stream", "--autoplay-policy=no-user-gesture-required",
         "http://localhost:8000/"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until(PATIENCE, lambda: told)
    browser.kill()
    browser.wait()
    answer = told[0] if told else {"error": "said nothing"}
    if "error" in answer or answer["size"] != [width, height]:
        report.check(f"{what}: {answer}", False)
    else:
        judge(what, answer["bars"])


def written():
    with open(f"/sys/class/video4linux/{os.path.basename(spare)}/format") as file:
        return file.read()


has_gstreamer = shutil.which("gst-inspect-1.0") and not subprocess.run(
    ["gst-inspect-1.0", "v4l2src"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode
if not has_gstreamer:
    report.say("SKIPPED: no GStreamer with v4l2src here (gstreamer1.0-plugins-good)")
has_browser = bool(shutil.which("chromium"))
if has_browser:
    threading.Thread(target=http.server.ThreadingHTTPServer(("127.0.0.1", 8000), Page).serve_forever, daemon=True).start()
else:
    report.say("SKIPPED: no Chromium here")
for n, (width, height) in enumerate(SIZES):
    for camera in NAMED or (CAMERAS if n == 0 else ("MJPG 4:2:2", "YUYV")):
        layout, coder = CAMERAS[camera]
        bars = f"/tmp/bars-{layout}"
        with open(bars, "wb") as file:
            file.write(samples(layout, width, height))
        source = subprocess.Popen(
            ["ffmpeg", "-nostdin", "-loglevel", "error", "-re", "-stream_loop", "-1", "-f", "rawvideo", "-pixel_format", layout,
             "-video_size", f"{width}x{height}", "-framerate", "10", "-i", bars, "-pix_fmt", layout, *coder, "-f", "v4l2", spare])
        report.check(f"ffmpeg gives {camera} {width}x{height}", until(PATIENCE, lambda: written().startswith(camera[:4])))
        for pixel in OUTPUTS:
            daemon = Daemon(sys.argv[1], out, f"camera.device={spare}", f"output.format={pixel}", "output.on_demand=false",
                            "stabilize.enabled=false", "crop.zoom=1", log=f"/tmp/colours-{camera[:4]}-{pixel}.log")
            if os.path.exists(daemon.log):
                os.unlink(daemon.log)
            daemon.start()
            live = camera_appears(out, 60) and until(60, lambda: "stabilizing" in daemon.said())
            what = f"{camera} {width}x{height} to {pixel}"
            report.check(f"{what}: is live", live)
            read(f"{what}, ffmpeg", width, height,
                 ["ffmpeg", "-nostdin", "-loglevel", "error", "-f", "v4l2", "-i", out, "-frames:v", "5", "-f", "rawvideo",
                  "-pix_fmt", "rgb24", "-"])
            if has_gstreamer:
                # 16 bits a sample: where it makes 8 of them, its own arithmetic is off by 5 (white becomes 253, green 250).
                read(f"{what}, GStreamer", width, height,
                     ["gst-launch-1.0", "-q", "v4l2src", f"device={out}", "num-buffers=5", "!", "videoconvert", "!",
                      "video/x-raw,format=ARGB64", "!", "fdsink", "fd=1"], 8, (3, 5, 7))
            if has_browser and camera in ("MJPG 4:2:2", "YUYV"):
                browse(f"{what}, Chromium", width, height)
            report.check(f"{what}: it stops", daemon.stop(30) == 0)
        source.kill()
        source.wait()
report.end()
