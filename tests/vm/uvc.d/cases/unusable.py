"""Cameras whose frames cannot be used, or that give none: it is said why, the camera is helped as far as that goes, and what is counted
is what happened."""
import os
import subprocess
import time

from bench import SOCKET, Case

BLACK = 18  # mean luma up to which a picture is black; the placeholder is brighter
ALL = "1000000000"


def ask(bench, *words):
    """What a command that talks to the daemon prints."""
    done = subprocess.run([bench.shared.program, *words, "--socket", SOCKET], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return done.stdout


def placeholder(bench, seconds):
    """Watches for so long; checks that the placeholder is shown all the time, and nothing black. The first picture may be another
    daemon's."""
    bench.reader.frames(0.5)
    frames = bench.reader.frames(seconds)
    lumas = [frame.luma for frame in frames]
    bench.note(f"{len(frames)} frames in {seconds} s, mean luma {min(lumas, default=0):.0f} to {max(lumas, default=0):.0f}")
    bench.check("watchers see the placeholder", lumas and all(not frame.live for frame in frames) and min(lumas) > BLACK)


def said(bench, words, times=None):
    """Checks how often the log has a line with these words; at least once where nothing is said of it."""
    count = sum(words in line for line in bench.said().splitlines())
    bench.check(f"the log says {words!r}: {times or 'at least 1'}, not {count}", count == times if times else count > 0)


def under_auto(bench):
    """JPEG that is none, where the format is chosen by gimbald: its raw format is taken, and remembered."""
    bench.note(bench.start_camera("nojpeg=1"))
    bench.check("it offers a picture", bench.start_daemon("camera.format=auto", "camera.width=0", "camera.height=0"))
    bench.open_reader()
    placeholder(bench, 2.5)
    said(bench, "frames cannot be decoded: the JPEG picture is damaged: ", 1)
    bench.live_within(15)
    status = bench.status()
    left = (status.get("formats_left") or [{}])[0]
    camera = status.get("camera") or {}
    bench.check(f"it streams YUYV, not {camera.get('format')}", camera.get("format") == "YUYV")
    bench.check(f"MJPG was left, with the reason: {left}", left.get("format") == "MJPG" and "cannot be decoded" in left.get("what", ""))
    bench.check(f"one restart: {status.get('drops')}", status.get("drops", {}).get("restarts") == 1)
    said(bench, "no usable frames in MJPG: trying YUYV instead", 1)
    bench.check("doctor says it", "MJPG of" in (told := ask(bench, "doctor")) and "was rejected" in told)
    bench.reader.close()
    time.sleep(2)
    bench.check("the camera is closed when nobody watches", not bench.camera_in_use())
    bench.open_reader()
    bench.live_within(5)
    bench.check("it is remembered", (bench.status().get("camera") or {}).get("format") == "YUYV")
    said(bench, "no usable frames in MJPG", 1)


def as_configured(bench):
    """The same where the format is configured: the stream is restarted, everything says why, and it goes on when that is over."""
    bench.note(bench.start_camera("nojpeg=1"))
    bench.check("it offers a picture", bench.start_daemon("camera.format=mjpeg"))
    bench.open_reader()
    placeholder(bench, 8)
    status = bench.status()
    unusable, drops = status.get("unusable") or {}, status.get("drops") or {}
    words = f"{unusable.get('of')} of {unusable.get('of')} frames cannot be decoded: the JPEG picture is damaged: "
    bench.check(f"the status says why: {unusable}", unusable.get("what", "").startswith(words) and unusable.get("reason") == "damaged")
    bench.check("its sentence, too", "cannot be decoded" in status.get("what", ""))
    bench.check(f"2 restarts: {drops}", drops.get("restarts") == 2 and drops.get("damaged", 0) > 100)
    metric = [line for line in ask(bench, "status", "--prometheus").splitlines() if line.startswith('gimbald_unusable_frames_total{reason="damaged"}')]
    bench.check(f"Prometheus counts it: {metric}", metric and float(metric[0].split()[-1]) > 100)
    told = ask(bench, "doctor")
    bench.check("doctor says it, and what to do", "frames cannot be decoded" in told and 'camera.format = "auto"' in told)
    bench.webcam("set", "nojpeg=0")
    bench.live_within(5)
    bench.watch(1)
    said(bench, "frames cannot be decoded: ", 1)
    said(bench, "frames are usable again", 1)
    bench.check("the sentence is as before", "cannot be decoded" not in bench.status().get("what", "cannot be decoded"))
    bench.check(f"{bench.stats().get('starts')} starts", bench.stats().get("starts") == 3)


def by_all_formats(bench):
    """No format works: all are tried in turn, and the first that does again is taken."""
    bench.note(bench.start_camera(f"firstbad={ALL}"))
    bench.check("it offers a picture", bench.start_daemon("camera.format=auto"))
    bench.open_reader()
    placeholder(bench, 21)
    said(bench, "trying all formats again", 1)
    bench.webcam("set", "firstbad=0")
    bench.live_within(10)
    status = bench.status()
    left = [entry["format"] for entry in status.get("formats_left", [])]
    camera = (status.get("camera") or {}).get("format")
    bench.check(f"{camera} is used, and not told as left ({left})", camera in ("MJPG", "YUYV") and camera not in left)


def some_damaged(bench):
    """One frame in five: it is said once within seconds, and the picture goes on."""
    bench.note(bench.start_camera())
    bench.check("it offers a picture", bench.start_daemon())
    bench.open_reader()
    bench.live_within(15)
    bench.webcam("set", "cut=0.2")
    seen = bench.watch(4)
    bench.note(f"{seen}")
    bench.check("the picture goes on", seen.live > 4 and not seen.dark)
    bench.check(f"no restart: {bench.status().get('drops')}", bench.status().get("drops", {}).get("restarts") == 0)


def failed_transfer(bench):
    """One transfer fails: it is counted as that, and the stream's count and clock go on."""
    bench.note(bench.start_camera())
    bench.check("it offers a picture", bench.start_daemon("camera.width=640", "camera.height=480"))
    bench.open_reader()
    bench.live_within(15)
    bench.watch(3)
    before = bench.status().get("drops", {})
    bench.webcam("set", "urb_error=1")
    bench.note(f"after  {bench.watch(3)}")
    status = bench.status()
    after, new = status.get("drops", {}), {}
    for key in before:
        new[key] = after.get(key, 0) - before[key]
    bench.note(f"new since the fault: {new}")
    bench.check(f"1 failed transfer, not {new.get('failed_transfers')}", new.get("failed_transfers") == 1)
    # What is left of the frame that the transfer was part of may come as a frame of its own.
    bench.check("at most one damaged, no restart", new.get("damaged", 99) <= 1 and new.get("restarts") == 0)
    bench.check(f"{new.get('camera_missing')} missing, 30 at most", new.get("camera_missing", 99) <= 30)
    bench.check("latency tells that the clock went on", (status.get("latency_ms") or {}).get("max", 1e9) < 5000)
    said(bench, "a transfer from the camera failed", 1)


def one_frame_for_each_start(bench):
    """FID never changes: uvcvideo gives one frame after each start. It is said once, and tried ever more rarely."""
    bench.note(bench.start_camera("nofid=1"))
    bench.check("it offers a picture", bench.start_daemon())
    bench.open_reader()
    bench.watch(28)
    drops, starts = bench.status().get("drops", {}), bench.stats().get("starts")
    bench.note(f"{starts} starts")
    bench.check(f"2 restarts: {drops}", drops.get("restarts") == 2)
    said(bench, "one frame when the stream started", 1)
    bench.check("its frames are not called missing", drops.get("camera_missing") == 0)
    bench.check("the status says that none comes", "no frames received" in bench.status().get("what", ""))


def with_the_quirk(bench):
    """What is advised then: uvcvideo's quirk for such cameras."""
    parameter = "/sys/module/uvcvideo/parameters/quirks"
    subprocess.run(["modprobe", "uvcvideo"], check=False)
    with open(parameter) as file:
        before = file.read().strip()
    set_to(parameter, "16")
    try:
        bench.note(bench.start_camera("nofid=1"))
        bench.check("it offers a picture", bench.start_daemon())
        bench.open_reader()
        bench.live_within(15)
        bench.note(str(bench.watch(3)))
        captured = bench.status().get("frames", {}).get("captured", 0)
        bench.check(f"it streams: {captured} frames", captured > 30)
    finally:
        set_to(parameter, before)


def another_mode_than_asked(bench):
    """JPEG that is none, of a camera that answers JPEG whatever is asked: the format that is refused is not asked for for ever."""
    bench.note(bench.start_camera("nojpeg=1", "probe_fixed=1:2"))
    bench.check("it offers a picture", bench.start_daemon("camera.format=auto"))
    bench.open_reader()
    placeholder(bench, 12)
    said(bench, "trying all formats again: ")
    bench.webcam("set", "nojpeg=0")
    bench.live_within(15)
    bench.check("MJPG is used", (bench.status().get("camera") or {}).get("format") == "MJPG")


def recorded_and_calibrated(bench):
    """record keeps what the camera gives and warns; calibrate blames the frames."""
    node, file = bench.start_camera("nojpeg=1"), "/tmp/gimbald-unusable.gbr"
    mode = ["--set", "camera.format=mjpeg", "--set", "camera.width=640", "--set", "camera.height=480"]

    def run(*words):
        return subprocess.run([bench.shared.program, *words], capture_output=True, text=True)

    done = run("record", "--device", node, "--output", file, "--seconds", "3", *mode)
    bench.check(f"record warns: {done.stderr}", done.returncode == 0 and "of the frames that were checked" in done.stderr and "cannot be decoded" in done.stderr)
    done = run("check", file)
    bench.check(f"check says it of all: {done.stdout} {done.stderr}", done.returncode == 65 and "frames cannot be decoded" in done.stdout)
    done = run("calibrate", node, "--seconds", "3", *mode)
    bench.check(f"calibrate blames the frames: {done.stderr}", done.returncode == 69 and "cannot be decoded" in done.stderr and "motion" not in done.stderr)
    os.unlink(file)


def set_to(path, text):
    with open(path, "w") as file:
        file.write(text)


CASES = [
    Case("no-jpeg-under-auto", under_auto, core=True),
    Case("no-jpeg-as-configured", as_configured, core=True),
    Case("no-format-works", by_all_formats),
    Case("no-jpeg-and-no-other-mode", another_mode_than_asked),
    Case("no-jpeg-recorded", recorded_and_calibrated),
    Case("some-frames-cut", some_damaged),
    Case("one-failed-transfer", failed_transfer, core=True),
    Case("one-frame-for-each-start", one_frame_for_each_start),
    Case("one-frame-with-the-quirk", with_the_quirk),
]
