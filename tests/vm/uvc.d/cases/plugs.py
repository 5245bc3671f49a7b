"""A camera that is unplugged, held or taken by others while gimbald has it."""
import os
import subprocess

from cases.faults import Fault
from rig import Reader, now, until
from bench import Case, camera_nodes


def unplug(bench):
    bench.webcam("unplug")
    seen = bench.watch(3)
    if not seen.dark:
        seen = bench.watch(7)
    bench.note(f"unplugged: {seen.frames} frames in {seen.seconds} s, {seen.dark} of them the placeholder")
    bench.check("watchers get the placeholder meanwhile", seen.dark > 0)
    bench.webcam("plug")


def replug(bench):
    bench.webcam("unplug")
    bench.webcam("plug")


def replug_often(bench):
    for _ in range(10):
        bench.webcam("unplug")
        bench.watch(0.3)
        bench.webcam("plug")
        bench.watch(0.7)


def held(bench):
    """Another process holds the old node: the camera comes back under another number."""
    before = camera_nodes()[0]
    old = os.open(before, os.O_RDWR)
    bench.webcam("unplug")
    bench.watch(1)
    bench.webcam("plug")
    bench.watch(2)
    bench.note(f"was {before}, is {camera_nodes()[:1]}")
    os.close(old)


def taken(bench):
    """Another program has the camera for a while."""
    bench.webcam("unplug")
    bench.watch(0.5)
    bench.webcam("plug")
    other = None

    def take():
        nonlocal other
        try:
            other = Reader(camera_nodes()[0])
        except (OSError, IndexError):
            return False
        return True
    until(3, take)
    bench.note("the other program got it" if other else "the other program did not get it")
    if other:
        seen = bench.watch(3)
        bench.note(f"meanwhile {seen.frames} frames, {seen.dark} of them the placeholder")
        other.close()


def controls(bench):
    """Another program turns the camera's controls while it streams."""
    node, began = camera_nodes()[0], now()
    for step in range(20):
        turn(node, f"brightness={step},zoom_absolute={100 + 10 * step}")
    said = turn(node, "pan_absolute=3600,tilt_absolute=-3600,power_line_frequency=2,auto_exposure=1,exposure_time_absolute=100")
    bench.note(f"controls turned in {now() - began:.1f} s")
    bench.check(f"v4l2-ctl turns them: {said}", not said)


def turn(node, controls_):
    done = subprocess.run(["v4l2-ctl", "-d", node, "-c", controls_], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return done.stdout.strip()[:200]


FAULTS = [
    Fault("unplug-3-s", act=unplug),
    Fault("unplug-replug-at-once", act=replug, seconds=1),
    Fault("unplug-10-times", act=replug_often, seconds=1),
    Fault("unplug-while-held", act=held, seconds=2),
    Fault("another-program-has-it", act=taken),
    Fault("controls-while-streaming", act=controls, during=0.65),
]
CASES = [Case(fault.name, fault.run, core=fault.name == "unplug-3-s") for fault in FAULTS]
