"""The PipeWire camera and the loopback side by side, with two programs that watch the former and one that reads the latter.

    GIMBALD_VM="tests/vm/machine --timeout 1500" tests/vm/guest pipewire-endurance [SECONDS [WIDTH HEIGHT]]    (600 1280 720)

Nothing may be lost for PipeWire that the loopback's reader gets, at most a millisecond (median) is added beside the loopback's path, and
the memory of the companion and of the daemon stays as it is. A picture is known again by its stamp, which is the camera's on both ways.
"""
import glob
import json
import os
import subprocess
import sys

from desktop import Clock, Session, skip_if_lacking
from rig import Camera, Daemon, Reader, Report, camera_appears, loopback, now, percentile, until

PROGRAM = sys.argv[1]
SECONDS = float(sys.argv[2]) if len(sys.argv) > 2 else 600.0
SIZE = tuple(int(word) for word in sys.argv[3:5]) if len(sys.argv) > 4 else (1280, 720)
report = Report()
skip_if_lacking()


def processor_s(pid):
    """Processor time of all threads, from the scheduler's nanoseconds."""
    total = 0
    for path in glob.glob(f"/proc/{pid}/task/*/schedstat"):
        with open(path) as file:
            total += int(file.read().split()[0])
    return total / 1e9


def memory_mib(pid):
    """Resident memory without the pictures that are shared, MiB."""
    with open(f"/proc/{pid}/status") as file:
        values = dict(line.split(":", 1) for line in file if line.startswith("Rss"))
    return (int(values["RssAnon"].split()[0]) + int(values["RssFile"].split()[0])) / 1024


def descriptors(pid):
    return len(os.listdir(f"/proc/{pid}/fd"))


def counts():
    said = subprocess.run([PROGRAM, "status", "--json"], capture_output=True, text=True).stdout
    status = json.loads(said)
    return status["frames"]["sent"], status["pipewire"]["sent"], status["pipewire"]["dropped"]


def read(reader, seconds, look=lambda: None):
    """(when it came, its stamp) of every picture within so many seconds."""
    frames, end, next_look = [], now() + seconds, now()
    while now() < end:
        if frame := reader.frame(2):
            frames.append((frame.came, frame.taken))
        if now() >= next_look:
            look()
            next_look += max(5.0, SECONDS / 60)
    return frames


def matched(frames, clock):
    """For each picture that both had: how much later the program had it than the loopback's reader (seconds). A program's stamps count from
    its own beginning: the shift is the one under which most pictures meet."""
    stamps = {round(taken * 1e6) // 10: came for came, taken in frames}
    meet = lambda shift: [came - stamps[key] for came, stamp in zip(clock.came, clock.stamps)
                          for key in ((round((stamp + shift) * 1e6)) // 10,) if key in stamps]
    if not clock.stamps or not frames:
        return []
    middle = len(clock.stamps) // 2
    shifts = [taken - clock.stamps[middle] + nudge for _, taken in frames for nudge in (0, 5e-6)]
    sample = Thinned(clock)
    best = max(shifts, key=lambda shift: sum(round((stamp + shift) * 1e6) // 10 in stamps for stamp in sample.stamps))
    return meet(best)


class Thinned:
    """A few of a program's pictures, enough to find the shift."""

    def __init__(self, clock):
        middle = len(clock.stamps) // 2
        self.stamps = clock.stamps[max(0, middle - 20):middle + 20]


out = loopback()
Camera.control("test_pattern=0,horizontal_movement=4,vertical_movement=3")
session = Session("endurance", PROGRAM)
companion = session.companion()
daemon = Daemon(PROGRAM, out, "camera.format=yuyv", f"camera.width={SIZE[0]}", f"camera.height={SIZE[1]}", "camera.fps=30",
                env={"XDG_RUNTIME_DIR": session.place}).start()
report.check("the loopback becomes a camera", camera_appears(out))
report.check("the node is there", until(20, lambda: session.size() == {"width": SIZE[0], "height": SIZE[1]}))
with Reader(out) as reader:
    report.check("the picture is live", reader.live(10, 30) is not None)
    span = max(20.0, SECONDS / 10)
    before = processor_s(daemon.pid)
    read(reader, span)
    alone = 100 * (processor_s(daemon.pid) - before) / span
    report.say(f"      the loopback alone: the daemon takes {alone:.2f} % of a core")
    with Clock(session) as first, Clock(session) as second:
        report.check("two programs watch", until(20, lambda: len(first.came) > 60 and len(second.came) > 60))
        looks = []

        def look():
            looks.append((memory_mib(daemon.pid), memory_mib(companion.pid), descriptors(daemon.pid), descriptors(companion.pid)))
            if len(looks) % 10 == 1:
                report.say("      daemon %.1f MiB, companion %.1f MiB; descriptors %d, %d" % looks[-1])

        at, counted = [len(first.came), len(second.came)], counts()
        begun, spent = now(), [processor_s(daemon.pid), processor_s(companion.pid)]
        frames = read(reader, SECONDS, look)
        seconds = now() - begun
        used = [100 * (processor_s(pid) - was) / seconds for pid, was in zip((daemon.pid, companion.pid), spent)]
        sent, lent, dropped = (after - was for after, was in zip(counts(), counted))
        until(2, lambda: False)
    report.say(f"      {len(frames)} pictures read from the loopback in {seconds:.1f} s; daemon: {sent} sent, {lent} to the companion, {dropped} dropped")
    report.check(f"{dropped} pictures dropped for the companion", dropped == 0)
    for name, clock, start in (("first", first, at[0]), ("second", second, at[1])):
        missing = sum(b - a - 1 for a, b in zip(clock.numbers[start:], clock.numbers[start + 1:]) if b > a)
        report.check(f"{name}: {len(clock.came) - start} pictures, {missing} missing by their numbers", missing == 0)
        report.check("      in order", all(b > a for a, b in zip(clock.numbers[start:], clock.numbers[start + 1:])))
        later = [1000 * value for value in matched(frames, clock)]
        if report.check(f"      {len(later)} of them known again at the loopback", len(later) > 0.9 * len(frames)):
            report.check("      later than at the loopback's reader by %.2f ms (median; 1 at most), %.2f (99 of 100), %.2f (worst)"
                         % tuple(percentile(later, p) for p in (0.5, 0.99, 1)), percentile(later, 0.5) <= 1)
    report.say(f"      daemon {used[0]:.2f} % of a core, {used[0] - alone:.2f} more than with the loopback alone (2 asked); companion {used[1]:.2f} % (1 asked)")
    for index, name in enumerate(("daemon", "companion")):
        early, late = max(look[index] for look in looks[1:4]), max(look[index] for look in looks[-3:])
        report.check(f"{name}: memory {early:.1f} then {late:.1f} MiB", late <= early + 2)
        report.check(f"      descriptors {looks[1][2 + index]} then {looks[-1][2 + index]}", looks[-1][2 + index] <= looks[1][2 + index])
daemon.stop()
if report.failed:
    print(daemon.said()[-3000:], session.said()[-3000:])
session.end()
report.end()
