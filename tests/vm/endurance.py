"""720p at 30 a second from the camera to a reader. In the virtual machine; arguments: the program, for how long (600 seconds), how the
camera's pattern moves (4 3), settings of the daemon (none).

Nothing that the camera delivered may be lost, the order is kept, the daemon adds little, and its memory stays as it is. On a machine
that does other work too, give the virtual machine the first right to the processor (`chrt -r 10 tests/vm/guest endurance`), and the
loopback `max_buffers=8`, so that a late reader is no reason.
"""
import re
import sys

from rig import Camera, Daemon, Reader, Report, camera_appears, loopback, now, percentile


def counted(said, what):
    """The number before a word in what the daemon says; what did not happen is left out."""
    found = re.search(r"(\d+) " + what, said)
    return int(found.group(1)) if found else 0


SECONDS = float(sys.argv[2]) if len(sys.argv) > 2 else 600.0
SIZE, FPS = (1280, 720), 30
SETTINGS = sys.argv[5:]
# With look-ahead a frame waits for what comes, by at most so much.
LOOKAHEAD_MS = sum(float(word.partition("=")[2]) for word in SETTINGS if word.startswith("smooth.lookahead_ms="))
report, out = Report(), loopback()
# The pattern moves slowly enough to be followed as a camera's motion.
Camera.control("test_pattern=0,horizontal_movement=%s,vertical_movement=%s" % (tuple(sys.argv[3:5]) if len(sys.argv) > 4 else (4, 3)))

with Reader(Camera.path(), size=SIZE, fps=FPS) as camera:
    frames = camera.frames(10)[10:]
# The driver leaves out ticks without counting them, too, where its own thread comes late.
skipped = sum(round((b.taken - a.taken) * FPS) - 1 for a, b in zip(frames, frames[1:]))
counted_out = frames[-1].sequence - frames[0].sequence - (len(frames) - 1)
own = [1000 * (frame.came - frame.taken) for frame in frames]
report.say(f"the camera alone: {len(frames)} frames, {percentile(own, 0.5):.2f} ms old when read (median), "
           f"{percentile(own, 0.99):.2f} (99 of 100); it left out {skipped} ticks, {counted_out} by its own count")

daemon = Daemon(sys.argv[1], out, "camera.format=yuyv", f"camera.width={SIZE[0]}", f"camera.height={SIZE[1]}",
                f"camera.fps={FPS}", *SETTINGS).start()
report.check("the loopback becomes a camera", camera_appears(out))
with Reader(out) as reader:
    report.check("the picture is live", reader.live(10, 30) is not None)
    ages, gaps, overtaken, backwards, dark, count, memory = [], [], 0, 0, 0, 0, []
    before, begun, cpu = reader.frame(2), now(), daemon.cpu()
    next_look = begun
    while now() < begun + SECONDS:
        frame = reader.frame(2)
        if frame is None:
            report.check(f"a frame within 2 s, at {now() - begun:.1f} s", False)
            break
        count += 1
        ages.append(1000 * (frame.came - frame.taken))
        step = round((frame.taken - before.taken) * FPS)
        if step > 1:
            gaps.append((frame.taken - begun, step - 1))
        # the loopback counts what it was given: a count left out is a picture that was replaced before this reader took it
        overtaken += frame.sequence - before.sequence - 1
        backwards += frame.taken <= before.taken
        dark += not frame.live
        before = frame
        if now() >= next_look:
            memory.append((daemon.memory(), daemon.descriptors()))
            next_look += max(5.0, SECONDS / 60)
            if len(memory) % 10 == 1:
                report.say(f"      {count} frames, {memory[-1][0]:.1f} MiB, {memory[-1][1]} descriptors")
    seconds, cpu = now() - begun, daemon.cpu() - cpu
report.check("it ends well", daemon.stop() == 0)
said = daemon.said()
closed = re.findall(r"camera closed: (.*)", said)[-1]
totals = re.findall(r"stream ended: (.*)", said)[-1]
sent = re.findall(r"loopback closed.*sent=(\d+) dropped=(\d+)", said)
report.say(f"      camera: {closed}")
report.say(f"      pipeline: {totals}")
report.say("      loopback: %s sent, %s without a buffer" % sent[-1])
missing = counted(closed, "missing")
missed = sum(lost for _, lost in gaps)
report.say(f"      reader: {count} frames in {seconds:.1f} s ({count / seconds:.3f} a second), {missed} of the camera's ticks not seen",
           f"{missing} by the driver's count", [f"{lost} at {at:.1f} s" for at, lost in gaps[:20]])
# Until the pipeline has its memory, nobody takes the camera's frames: all its buffers but one go unseen once, before the first picture.
unseen = max(0, counted(closed, "stale") - 5)
lost = unseen + counted(totals, "dropped") + int(sent[-1][1])
report.check(f"{lost} frames lost that the camera delivered", lost == 0)
report.check(f"{overtaken} pictures replaced in the loopback before the reader took them", overtaken == 0)
report.check(f"order kept: {backwards} times back, {dark} pictures dark", backwards == 0 and dark == 0)
added = [age - percentile(own, 0.5) for age in ages]
report.say("      age when read: median %.2f ms, 99 of 100 %.2f, worst %.2f" % tuple(percentile(ages, p) for p in (0.5, 0.99, 1)))
median, most, worst = (percentile(added, p) for p in (0.5, 0.99, 1))
report.check(f"added: median {median:.2f} ms, 99 of 100 {most:.2f} ({20 + LOOKAHEAD_MS:.0f} at most), worst {worst:.2f}",
             most <= 20 + LOOKAHEAD_MS and median >= LOOKAHEAD_MS - 1500 / FPS)
early, late = [m for m, _ in memory[1:4]], [m for m, _ in memory[-3:]]
report.check(f"memory {min(early):.1f} then {max(late):.1f} MiB", max(late) <= max(early) + 2)
report.check(f"descriptors {memory[0][1]} then {memory[-1][1]}", memory[-1][1] <= memory[0][1])
report.say(f"      {100 * cpu / seconds:.1f} % of a core")
report.end()
