"""The camera is open only while somebody watches.

In the virtual machine; arguments: the program, width, height, frames a second (1280 720 30), how many times slower than a real one
the machine is (1): its times count so many times less.
"""
import sys
import time

from rig import Camera, Daemon, Reader, Report, camera_appears, loopback, now, until

WIDTH, HEIGHT, FPS = (int(word) for word in sys.argv[2:5]) if len(sys.argv) > 4 else (1280, 720, 30)
SLOWER = float(sys.argv[5]) if len(sys.argv) > 5 else 1.0
SIZE = [f"camera.width={WIDTH}", f"camera.height={HEIGHT}", f"camera.fps={FPS}"]
report, out = Report(), loopback()
Camera.move()
daemon = Daemon(sys.argv[1], out, *SIZE, "output.linger_s=2").start()
begun = now()
report.check("the loopback becomes a camera", camera_appears(out))
report.say(f"      {now() - begun:.3f} s after the start")
time.sleep(1)
report.check("and the camera is closed", not Camera.is_open())

begun = now()
report.check("the camera itself gives its frames evenly", Camera.becomes_even((WIDTH, HEIGHT), FPS, SLOWER))
report.say(f"      after {now() - begun:.1f} s")

# How long the camera itself takes to its first frame.
own = []
for _ in range(3):
    with Reader(Camera.path(), size=(WIDTH, HEIGHT), fps=FPS) as reader:
        own.append(reader.frame(5).came - reader.started)
report.say("      the camera's own first frame comes after", *(f"{seconds:.3f}" for seconds in own), "s")

added = []
for visit in range(5):
    with Reader(out) as reader:
        first = reader.frame(5)
        while (frame := reader.frame(5)) and not frame.live:
            pass
        if not report.check(f"visit {visit}: a live picture comes", bool(frame)):
            break
        added.append(frame.came - reader.started - max(own))
        report.say(f"      first picture after {first.came - reader.started:.3f} s, live after {frame.came - reader.started:.3f} s")
        frames = reader.frames(1.5 * min(SLOWER, 5))
        report.check("      and moves", len({frame.sum for frame in frames if frame.live}) > 20 / SLOWER)
        report.check("      its times only go up", all(b.taken > a.taken for a, b in zip(frames, frames[1:])))
        report.check("      the camera is open", Camera.is_open())
    left = now()
    report.check("      it stays open for a while", Camera.is_open())
    report.check("      and is closed then", until(6, lambda: not Camera.is_open()))
    report.say(f"      {now() - left:.2f} s after the reader left")
    time.sleep(0.3)
    with Reader(out) as reader:
        old = reader.frame(5)
        report.check("      nothing of the old picture is left", old and not old.live)
    until(6, lambda: not Camera.is_open())
report.check(f"live at most 0.5 s after the camera's own start: {max(added):.3f} s at worst", max(added) <= 0.5 * SLOWER)

report.say("somebody who only looks in, every 1.5 s")
opened = 0
for visit in range(8):
    with Reader(out) as reader:
        reader.frame(0.3)
    time.sleep(1.3)
    opened += visit >= 4 and Camera.is_open()
if SLOWER == 1:
    report.check("does not keep the camera open", opened == 0)
else:
    report.say(f"      has it open {opened} of 4 times: on a slow machine a short look is a long one")
with Reader(out) as reader:
    report.check("who stays is served all the same", reader.live(5) is not None)
    report.say(f"      after {now() - reader.started:.3f} s")
until(6, lambda: not Camera.is_open())

time.sleep(2)
seconds = 30
before, begun = [daemon.cpu(), daemon.cpu_exact()], now()
time.sleep(seconds)
ticks, exact = [(after - before) / (now() - begun) for after, before in zip([daemon.cpu(), daemon.cpu_exact()], before)]
report.say(f"      by the clock's ticks {100 * ticks:.3f} %, by the scheduler {100 * exact:.3f} %")
used = max(ticks, exact) / SLOWER
# A daemon that never wakes up uses nothing: what it used before shows that it is counted.
report.check("the scheduler counts", daemon.cpu_exact() > 0)
report.check(f"idle, it uses {100 * used:.3f} % of a core (0.2 at most)", used <= 0.002)
report.check("it stops", daemon.stop() == 0)

daemon = Daemon(sys.argv[1], out, *SIZE, "output.on_demand=false").start()
report.check("on_demand = false: the camera is open without anybody", until(10, Camera.is_open))
time.sleep(8)
report.check("and stays so", Camera.is_open())
with Reader(out) as reader:
    frame = reader.frame(5) and reader.frame(5)
    report.check("the picture is live at once", frame and frame.live)
report.check("it stops", daemon.stop() == 0)
if report.failed:
    print(daemon.said())
report.end()
