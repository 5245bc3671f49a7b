"""Other programs read what gimbald writes, by each of its formats; it reads a camera that gives JPEG; it makes its own device.

In the virtual machine; arguments: the program, width, height, frames a second (640 480 30), how many times slower than a real one
the machine is (1).
"""
import glob
import os
import shutil
import subprocess
import sys
import time

from rig import Camera, Daemon, Manager, Reader, Report, camera_appears, identity, identity_or_none, loopback, nodes, until

WIDTH, HEIGHT, FPS = (int(word) for word in sys.argv[2:5]) if len(sys.argv) > 4 else (640, 480, 30)
SLOWER = float(sys.argv[5]) if len(sys.argv) > 5 else 1.0
SIZE = [f"camera.width={WIDTH}", f"camera.height={HEIGHT}", f"camera.fps={FPS}"]
PATIENCE = 240
report, out, manager = Report(), loopback(), Manager()
version = os.environ.get("V4L2LOOPBACK_VERSION")
try:
    version = open("/sys/module/v4l2loopback/version").read().strip()
except OSError:
    pass  # older ones do not say
report.say(f"v4l2loopback {version}, {out}, {WIDTH}x{HEIGHT} at {FPS}")
Camera.move()
BYTES = {"yuyv": WIDTH * HEIGHT * 2, "i420": WIDTH * HEIGHT * 3 // 2, "nv12": WIDTH * HEIGHT * 3 // 2}


def run(what, frame_bytes, frames, arguments):
    """A program that writes raw frames to its standard output: how many, and how many different bright ones."""
    if not shutil.which(arguments[0]):
        report.say(f"SKIPPED: {what}: {arguments[0]} is not installed")
        return
    try:
        done = subprocess.run(arguments, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        report.check(f"{what}: did not end", False)
        return
    data = done.stdout
    pictures = [data[at:at + frame_bytes] for at in range(0, len(data) - frame_bytes + 1, frame_bytes)]
    # luma in planar frames; in YUYV the even bytes
    live = {hash(picture) for picture in pictures if sum(picture[0:WIDTH * HEIGHT:1022]) / len(picture[0:WIDTH * HEIGHT:1022]) > 50}
    report.check(f"{what}: {len(pictures)} of {frames} frames, {len(live)} live and different, exit {done.returncode}",
                 done.returncode == 0 and len(pictures) >= frames and len(live) >= frames / 3 / SLOWER)
    if done.returncode:
        print(done.stderr.decode(errors="replace")[-600:])


def programs(pixel, frames):
    size = BYTES[pixel]
    gst = {"yuyv": "YUY2", "i420": "I420", "nv12": "NV12"}[pixel]
    ffmpeg = {"yuyv": "yuyv422", "i420": "yuv420p", "nv12": "nv12"}[pixel]
    run(f"v4l2-ctl, {pixel}", size, frames,
        ["v4l2-ctl", "-d", out, "--stream-mmap", f"--stream-count={frames}", "--stream-to=-"])
    # ffmpeg fills the time between the placeholder and the first live picture with the former, at the full rate
    frames *= 3
    run(f"ffmpeg, {pixel}", size, frames,
        ["ffmpeg", "-nostdin", "-loglevel", "error", "-f", "v4l2", "-i", out, "-frames:v", str(frames), "-f", "rawvideo",
         "-pix_fmt", ffmpeg, "-"])
    frames //= 3
    run(f"gst-launch, {pixel}", size, frames,
        ["gst-launch-1.0", "-q", "v4l2src", f"device={out}", f"num-buffers={frames}", "!",
         f"video/x-raw,format={gst},width={WIDTH},height={HEIGHT}", "!", "fdsink", "fd=1"])


def written(path):
    """The format in which a loopback device is written to."""
    with open(f"/sys/class/video4linux/{os.path.basename(path)}/format") as file:
        return file.read()


def started(daemon):
    """Starts it, and waits until its camera streams: until then readers have pictures of the one before."""
    before = daemon.said().count("stabilizing") if os.path.exists(daemon.log) else 0
    daemon.start()
    report.check("its camera streams", until(60, lambda: daemon.said().count("stabilizing") > before))
    return daemon


def stopped(daemon):
    report.check("it stops", daemon.stop(30) == 0)


for pixel in ("yuyv", "i420", "nv12"):
    daemon = Daemon(sys.argv[1], out, *SIZE, f"output.format={pixel}", "output.linger_s=1").start()
    report.check(f"{pixel}: the loopback becomes a camera", camera_appears(out, 60))
    programs(pixel, 30)
    stopped(daemon)

report.say("readers that ask for fewer buffers than the daemon has: no picture comes back after a newer one")
daemon = Daemon(sys.argv[1], out, *SIZE).start()
camera_appears(out, 60)
for buffers in (2, 3, 4):
    with Reader(out, buffers=buffers) as reader:
        report.check(f"{buffers} buffers: live", reader.live(60) is not None)
        sums = [frame.sum for frame in reader.frames(3) if frame.live]
        order = [now for before, now in zip([None, *sums], sums) if now != before]
        report.check(f"{len(order)} pictures, {len(order) - len(set(order))} come back", len(order) > 10 / SLOWER and len(order) == len(set(order)))
stopped(daemon)

report.say("a reader through a restart of the daemon, and one of another format")
daemon = Daemon(sys.argv[1], out, *SIZE, env={"NOTIFY_SOCKET": manager.path}).start()
camera_appears(out, 60)
with Reader(out) as reader:
    report.check("live", reader.live(60) is not None)
    stopped(daemon)
    started(daemon)
    report.check("live again, without opening it anew", reader.live(60) is not None)
    stopped(daemon)
    other = started(Daemon(sys.argv[1], out, "camera.width=320", "camera.height=180", "camera.fps=15"))
    report.check("live from a daemon whose camera has another size", reader.live(60) is not None)
    report.check("in the size that the reader has", (reader.width, reader.height) == (WIDTH, HEIGHT))
    stopped(other)

report.say("a camera that gives JPEG: ffmpeg writes to a second loopback")
spare = next(path for path in nodes() if path != out and identity_or_none(path) == "v4l2 loopback")
source = ["ffmpeg", "-nostdin", "-loglevel", "error", "-re", "-f", "lavfi", "-i", f"testsrc2=size=640x480:rate={min(FPS, 15)}",
          "-pix_fmt", "yuvj422p", "-c:v", "mjpeg", "-f", "v4l2", spare]
ffmpeg = subprocess.Popen(source, stderr=subprocess.DEVNULL)
report.check("ffmpeg writes JPEG", until(PATIENCE, lambda: written(spare).startswith("MJPG")))
daemon = Daemon(sys.argv[1], out, f"camera.device={spare}", "output.linger_s=1").start()
report.check("the loopback becomes a camera", camera_appears(out, 60))
with Reader(out) as reader:
    report.check("live from JPEG", reader.live(60, 5) is not None)
    ffmpeg.kill()
    ffmpeg.wait()
    time.sleep(2)
    report.check("the daemon lives on without it", daemon.alive())
    ffmpeg = subprocess.Popen(source, stderr=subprocess.DEVNULL)
    report.check("live again when it is back", reader.live(60, 5) is not None)
stopped(daemon)

report.say("a link that names another camera, of another format and size, while somebody watches")
# Not in /tmp: a service has one of its own.
link = "/run/the-camera"
if os.path.islink(link):
    os.unlink(link)
os.symlink(Camera.path(), link)
other = Daemon(sys.argv[1], out, f"camera.device={link}").start()
report.check("the loopback becomes a camera", camera_appears(out, 60))
with Reader(out) as reader:
    report.check("live", reader.live(60, 5) is not None)
    os.unlink(link)
    os.symlink(spare, link)
    Camera.control("disconnect=1")
    report.check("one that was there beside it is not taken", until(20, lambda: "restart gimbald to use it" in other.said()))
    other.stop()
    before = len(other.said())
    other.start()
    report.check("live from it after a restart", reader.live(60, 5) is not None and f"camera={spare} format=MJPG" in other.said()[before:])
    report.check("still in the reader's size", reader.width == 1280)
stopped(other)
ffmpeg.kill()
ffmpeg.wait()
if "MJPG" not in daemon.said():
    report.check("it was JPEG that was read", False)

if glob.glob("/dev/v4l2loopback"):
    report.say("a device of its own")
    # As the comment in 60-gimbald.rules says it is granted.
    shutil.chown("/dev/v4l2loopback", group="video")
    os.chmod("/dev/v4l2loopback", 0o660)
    known = set(nodes())
    label = "Steady camera"
    daemon = Daemon(sys.argv[1], label, *SIZE, "output.create=true").start()
    report.check("is made", until(30, lambda: set(nodes()) - known))
    made = (set(nodes()) - known).pop() if set(nodes()) - known else out
    name = open(f"/sys/class/video4linux/{os.path.basename(made)}/name").read().strip()
    report.check(f"{made} has its label: {name}", name == label)
    report.check("is a camera", camera_appears(made, 60) and identity(made)[1] & 3 == 1)
    with Reader(made) as reader:
        report.check("live", reader.live(60) is not None)
    stopped(daemon)
    before = set(nodes())
    daemon.start()
    report.check("is found by its label the next time", camera_appears(made, 60) and set(nodes()) == before)
    stopped(daemon)
else:
    report.say("SKIPPED: this v4l2loopback makes no devices while it is loaded")
if report.failed:
    print(daemon.said()[-20000:])
report.end()
