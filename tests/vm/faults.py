"""Rounds of random faults. In the virtual machine; arguments: the program, how many rounds (200), the seed (1), how long the machine
sleeps at the end (60 seconds).

Each round does one thing to the camera, the daemon, the reader or the module while somebody watches, and asks at its end: does the
daemon live, and is the picture live? The first half of the rounds also kills the daemon; the second half lets one daemon live through
all of it, and looks at what it leaves lying about.
"""
import os
import random
import signal
import subprocess
import sys
import time

from rig import Camera, Daemon, Manager, Reader, Report, camera_appears, identity, identity_or_none, loopback, nodes, now, percentile, until

ROUNDS = int(sys.argv[2]) if len(sys.argv) > 2 else 200
SEED = int(sys.argv[3]) if len(sys.argv) > 3 else 1
SLEEP = float(sys.argv[4]) if len(sys.argv) > 4 else 60
PATIENCE = 15  # seconds until a picture that does not come back is given up
chance = random.Random(SEED)
report, out = Report(), loopback()
SIZE = (640, 480)


def module():
    """The arguments that make the loopback devices as they are now."""
    made = [(path[10:], identity(path)[1]) for path in nodes() if identity_or_none(path) == "v4l2 loopback"]
    numbers, exclusive = ",".join(n for n, _ in made), ",".join("01"[caps & 3 != 3] for _, caps in made)
    return [f"devices={len(made)}", f"video_nr={numbers}", f"exclusive_caps={exclusive}"]


MODULE = module()


manager = Manager()
daemon = Daemon(sys.argv[1], out, f"camera.width={SIZE[0]}", f"camera.height={SIZE[1]}", "camera.fps=30", "output.linger_s=0.5",
                env={"NOTIFY_SOCKET": manager.path})
reader = None


def pause(low, high):
    time.sleep(chance.uniform(low, high))


def watch():
    """Reads for as long as a fault lasts, as an app would; gives the frames."""
    return reader.frames(chance.uniform(0.2, 1.0))


# Each fault returns when it is over; what was done to the reader is undone by then.
def unplugged_node_stays():
    Camera.control("disconnect=1")


def unplugged():
    Camera.unplug()
    pause(0.1, 3)
    Camera.plug()


def replugged_at_once():
    Camera.unplug()
    Camera.plug()


def replugged_as_another():
    """Somebody holds the old node: the camera comes back under another number."""
    old = os.open(Camera.path(), os.O_RDWR)
    before = Camera.path()
    Camera.unplug()
    pause(0.1, 1)
    Camera.plug()
    report.say(f"      {before} is now {Camera.path()}")
    global later
    later = lambda: os.close(old)


def driver_removed():
    Camera.unplug()
    removed = until(3, lambda: subprocess.run(["rmmod", "vivid"], capture_output=True).returncode == 0)
    pause(0.1, 1)
    if removed:
        subprocess.run(["modprobe", "vivid", "n_devs=1"], check=True)
    else:
        with open(Camera.place + "bind", "w") as file:
            file.write("vivid.0")
    until(3, Camera.path)
    Camera.move()


def stream_fails():
    Camera.control("inject_fatal_streaming_error=1")


def bad_frames():
    for _ in range(chance.randint(1, 5)):
        Camera.control("inject_v4l2_buf_flag_error=1")
        pause(0.01, 0.2)


def lost_frames():
    Camera.control("percentage_of_dropped_buffers=%d" % chance.choice([30, 60, 90]))
    watch()
    Camera.control("percentage_of_dropped_buffers=0")


def start_refused():
    Camera.control("inject_vidioc_streamon_error=1")
    Camera.control("disconnect=1")


def buffers_refused():
    Camera.control(chance.choice(["inject_vidioc_reqbufs_error=1", "inject_vidioc_qbuf_error=1"]))
    Camera.control(chance.choice(["disconnect=1", "inject_fatal_streaming_error=1"]))


def odd_clock():
    Camera.control("wrap_timestamp=%d,wrap_sequence_number=%d" % (chance.randint(0, 2), chance.randint(0, 1)))
    Camera.control("disconnect=1")
    watch()
    Camera.control("wrap_timestamp=0,wrap_sequence_number=0")
    Camera.control("disconnect=1")


def camera_taken():
    """Another program has the camera for a while."""
    Camera.unplug()
    pause(0.05, 0.2)
    Camera.plug()
    thief = None

    def take():
        nonlocal thief
        try:
            thief = Reader(Camera.path(), size=SIZE)
            return True
        except (OSError, TypeError):
            return False
    if until(1, take):
        thief.frames(chance.uniform(0.3, 2))
        thief.close()


def asleep():
    """The machine sleeps, as far as the daemon can tell; the camera's buffers are stale then."""
    daemon.process.send_signal(signal.SIGSTOP)
    pause(0.3, 4)
    daemon.process.send_signal(signal.SIGCONT)


def killed():
    daemon.kill()
    pause(0, 1)
    daemon.start()


def restarted():
    code = daemon.stop()
    report.check("      it ends well", code == 0)
    pause(0, 0.5)
    daemon.start()


def reader_goes():
    global reader
    reader.close()
    pause(0, 2)
    reader = again()


def reader_dies():
    """A call app that is killed."""
    global reader
    reader.close()
    app = subprocess.Popen(["v4l2-ctl", "-d", out, "--stream-mmap", "--stream-count=1000", "--stream-to=/dev/null"],
                           stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    pause(0.2, 1.5)
    app.kill()
    app.wait()
    reader = again()


def reader_is_slow():
    for _ in range(chance.randint(2, 6)):
        reader.frame(2)
        pause(0.1, 0.6)


def readers_look_in():
    global reader
    reader.close()
    for _ in range(chance.randint(2, 5)):
        with again() as other:
            other.frame(0.1)
        pause(0.05, 0.6)
    reader = again()


def module_reloaded():
    """v4l2loopback is exchanged below a daemon that starts without it."""
    global reader
    reader.close()
    daemon.kill()
    gone = until(3, lambda: subprocess.run(["rmmod", "v4l2loopback"], capture_output=True).returncode == 0)
    report.check("      the module could be removed", gone)
    daemon.start()
    pause(0.3, 2)
    report.check("      the daemon waits without a loopback", daemon.alive())
    subprocess.run(["modprobe", "v4l2loopback", *MODULE], check=True)
    until(5, lambda: identity_or_none(out) == "v4l2 loopback")
    reader = again()


def again():
    """A reader as soon as there is a camera to read."""
    end = now() + PATIENCE
    while True:
        try:
            return Reader(out)
        except OSError:
            if now() > end:
                raise
            time.sleep(0.02)


ANY = [unplugged_node_stays, unplugged, replugged_at_once, replugged_as_another, driver_removed, stream_fails, bad_frames,
       lost_frames, start_refused, buffers_refused, odd_clock, camera_taken, asleep, reader_goes, reader_dies, reader_is_slow,
       readers_look_in]
WITH_END = ANY + [killed, restarted, module_reloaded]

report.say(f"{ROUNDS} rounds, seed {SEED}, loopback {out}")
Camera.move()
daemon.start()
report.check("the loopback becomes a camera", camera_appears(out))
reader = again()
report.check("the picture is live", reader.live(PATIENCE) is not None)
late, last_taken, backwards, later = {}, 0.0, 0, None
marks = []
for number in range(ROUNDS):
    fault = chance.choice(WITH_END if number < ROUNDS // 2 else ANY)
    pause(0, 0.5)
    report.say(f"round {number}: {fault.__name__}")
    try:
        fault()
        over = now()
        came = None
        while now() < over + PATIENCE:
            # two different live pictures, both newer than what was under way at the end of the fault
            frames = []
            while now() < over + PATIENCE and len({frame.sum for frame in frames}) < 2:
                frame = reader.frame(0.5)
                if frame:
                    if frame.taken < last_taken:
                        backwards += 1
                        report.say(f"      time went back {last_taken - frame.taken:.3f} s, to number {frame.sequence}, "
                                   f"{'live' if frame.live else 'the placeholder'}, {frame.came - frame.taken:.3f} s old")
                    last_taken = frame.taken
                if frame and frame.live and frame.came > over + 0.15:
                    frames.append(frame)
            came = frames[-1].came if len({frame.sum for frame in frames}) >= 2 else None
            break
    except OSError as error:
        report.check(f"round {number} ({fault.__name__}): {error}", False)
        came, reader = None, again()
        over = now()
    if later:
        later()
        later = None
    alive = daemon.alive()
    if not alive or came is None:
        report.check(f"round {number} ({fault.__name__}): alive {alive}, live {came is not None}", False)
        if not alive:
            daemon.start()
            until(5, daemon.alive)
    else:
        late.setdefault(fault.__name__, []).append(came - over)
        report.say(f"      live {came - over:.2f} s after its end")
    manager.listen()
    if number >= ROUNDS // 2 and number % 10 == 5:
        marks.append((number, daemon.descriptors(), daemon.memory()))
        report.say(f"      {marks[-1][1]} descriptors, {marks[-1][2]:.1f} MiB")

report.say(f"the machine sleeps for {SLEEP:.0f} seconds; the camera's buffers are stale then")
daemon.process.send_signal(signal.SIGSTOP)
reader.frames(SLEEP)
daemon.process.send_signal(signal.SIGCONT)
over, came, oldest = now(), None, 0.0
# The picture that was being worked on then may still come.
first = reader.frame(PATIENCE)
came = first.came if first and first.live and first.came - first.taken < 0.5 else None
while came is None and (frame := reader.frame(PATIENCE)):
    oldest = max(oldest, frame.came - frame.taken)
    came = frame.came if frame.live else None
report.check(f"live {(came or now()) - over:.2f} s after it woke", came is not None and came - over <= 1)
report.check(f"nothing from before is shown: the oldest picture was {oldest:.2f} s old", oldest < 0.5)
report.check("and it lives", daemon.alive())

report.say("how long after a fault's end the picture was live: median and worst, seconds")
for name, times in sorted(late.items()):
    report.say(f"      {name:22} {len(times):3} times  {percentile(times, 0.5):5.2f}  {max(times):5.2f}")
every = [seconds for times in late.values() for seconds in times]
report.check(f"live within a second of the fault's end: {sum(s <= 1 for s in every)} of {len(every)}, worst {max(every):.2f} s",
             percentile(every, 0.99) <= 1)
report.check(f"{len(every)} of {ROUNDS} rounds ended with a live picture", len(every) == ROUNDS)
report.check(f"time went back {backwards} times for the reader", backwards == 0)
if len(marks) >= 2:
    report.check(f"descriptors {marks[0][1]} then {marks[-1][1]}", marks[-1][1] <= max(m[1] for m in marks[:2]) + 1)
    report.check(f"memory {marks[0][2]:.1f} then {marks[-1][2]:.1f} MiB", marks[-1][2] <= max(m[2] for m in marks[:3]) + 4)
report.check("READY was said", "READY=1" in manager.heard)
reader.close()
report.check("it ends well", daemon.stop() == 0)
lines = daemon.said().splitlines()
report.say(f"      {len(lines)} lines of log, {len(lines) / ROUNDS:.1f} a round")
if report.failed:
    print("\n".join(lines[-400:]))
report.end()
