"""A camera that is unplugged, held or taken by others while gimbald has it."""
import os
import subprocess

from cases.faults import Fault
from rig import Reader, now, until
from scene import Case, camera_nodes


def unplug(scene):
    scene.webcam("unplug")
    seen = scene.watch(3)
    scene.note(f"unplugged: {seen.frames} frames in 3 s, {seen.dark} of them the placeholder")
    scene.check("watchers get the placeholder meanwhile", seen.dark > 0)
    scene.webcam("plug")


def replug(scene):
    scene.webcam("unplug")
    scene.webcam("plug")


def replug_often(scene):
    for _ in range(10):
        scene.webcam("unplug")
        scene.watch(0.3)
        scene.webcam("plug")
        scene.watch(0.7)


def held(scene):
    """Another process holds the old node: the camera comes back under another number."""
    before = camera_nodes()[0]
    old = os.open(before, os.O_RDWR)
    scene.webcam("unplug")
    scene.watch(1)
    scene.webcam("plug")
    scene.watch(2)
    scene.note(f"was {before}, is {camera_nodes()[:1]}")
    os.close(old)


def taken(scene):
    """Another program has the camera for a while."""
    scene.webcam("unplug")
    scene.watch(0.5)
    scene.webcam("plug")
    other = None

    def take():
        nonlocal other
        try:
            other = Reader(camera_nodes()[0])
        except (OSError, IndexError):
            return False
        return True
    until(3, take)
    scene.note("the other program got it" if other else "the other program did not get it")
    if other:
        seen = scene.watch(3)
        scene.note(f"meanwhile {seen.frames} frames, {seen.dark} of them the placeholder")
        other.close()


def controls(scene):
    """Another program turns the camera's controls while it streams."""
    node, began = camera_nodes()[0], now()
    for step in range(20):
        turn(node, f"brightness={step},zoom_absolute={100 + 10 * step}")
    said = turn(node, "pan_absolute=3600,tilt_absolute=-3600,power_line_frequency=2,auto_exposure=1,exposure_time_absolute=100")
    scene.note(f"controls turned in {now() - began:.1f} s")
    scene.check(f"v4l2-ctl turns them: {said}", not said)


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
CASES = [Case(fault.name, fault.play, core=fault.name == "unplug-3-s") for fault in FAULTS]
