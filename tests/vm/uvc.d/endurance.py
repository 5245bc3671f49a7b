"""1080p30 motion JPEG from an emulated webcam to a reader of the loopback, with a random fault every ten seconds. In the virtual
machine, as root; arguments: the program, --pictures DIR, then for how long (600 seconds), the seed (1).

Between faults every frame that the camera exposes comes to the reader, or gimbald has counted it (a machine that does other work is too
late for some). What is lost while a fault lasts, and until the picture is live again, is the fault's, and is told with the counts of
camera and gimbald beside it. Memory and descriptors stay level. Without a fault (seed 0) it measures: rate, loss, and the share of a core;
then nothing may be lost at all.
"""
import argparse
import os
import random
import sys
from dataclasses import dataclass

sys.path.insert(1, os.path.dirname(os.path.dirname(os.path.realpath(__file__))))

from rig import Report, loopback, now
from bench import Bench, Shared, camera_nodes, link

SIZE, FPS = (1920, 1080), 30
PERIOD = 10.0
SETTLED = 1.0  # from the first live picture after a fault until every frame has to come: buffers have filled up meanwhile
UNDER_WAY = 4  # frames between the camera's count and the reader's, at most: counted in one period, seen in the next
RECOVERY = 8.0  # seconds until a picture that does not come back is a failure
KEPT = ("plugs", "starts", "frames", "corrupted", "cut", "emptied", "error_bits", "lost_payloads", "bad_headers", "urb_errors", "stalls")


def knob(setting, undo=None, low=0.5, high=3.0):
    """A fault that a knob makes for a while."""
    def fault(bench, chance):
        bench.webcam("set", *setting.split())
        bench.watch(chance.uniform(low, high))
        if undo:
            bench.webcam("set", *undo.split())
    fault.__name__ = setting
    return fault


def unplugged(bench, chance):
    bench.webcam("unplug")
    bench.watch(chance.uniform(0.1, 3))
    bench.webcam("plug")


def replugged_at_once(bench, _):
    bench.webcam("unplug")
    bench.webcam("plug")


def held(bench, chance):
    """Another process holds the old node: the camera comes back under another number."""
    old = os.open(camera_nodes()[0], os.O_RDWR)
    unplugged(bench, chance)
    bench.watch(chance.uniform(0.5, 2))
    os.close(old)


def refused(bench, chance):
    """It comes back and refuses to start at first."""
    bench.webcam("set", f"{chance.choice(['stall_probe', 'stall_commit', 'stall_alt'])}={chance.randint(1, 2)}")
    replugged_at_once(bench, chance)


FAULTS = [
    knob("corrupt=0.2", "corrupt=0"), knob("cut=0.3", "cut=0"), knob("empty=0.3", "empty=0"), knob("error=0.3", "error=0"),
    knob("drop=0.3", "drop=0"), knob("iso_error=0.3", "iso_error=0"), knob("badheader=0.3", "badheader=0"), knob("corrupt=1", "corrupt=0"),
    knob("error=1", "error=0"), knob("huffman=0", "huffman=1"), knob("trailing=700", "trailing=0"), knob("app4=90000", "app4=0"),
    knob("othersize=640x480", "othersize="), knob("slow=2", "slow=1"), knob("dark=1", "dark=0"), knob("pause=2", low=2, high=2.5),
    knob("urb_error=1", low=0.2, high=0.5), knob("urb_error=5", low=0.2, high=0.5), knob("hang=1", low=0.2, high=0.5),
    unplugged, replugged_at_once, held, refused]


@dataclass
class Counts:
    """What camera, gimbald and reader have counted at one time."""

    camera: dict
    gimbald: dict

    @classmethod
    def take(cls, bench):
        stats, status = bench.stats(), bench.status()
        drops = {f"drops.{key}": count for key, count in status.get("drops", {}).items()}
        return cls({key: stats.get(key, 0) for key in KEPT}, {**status.get("frames", {}), **drops})

    def since(self, before):
        """What was counted meanwhile, but what stayed as it was."""
        def gone(new, old):
            return {key: new[key] - old.get(key, 0) for key in new if new[key] != old.get(key, 0)}
        return Counts(gone(self.camera, before.camera), gone(self.gimbald, before.gimbald))

    def __str__(self):
        words = lambda counts: ", ".join(f"{key} {count}" for key, count in counts.items())
        return f"camera: {words(self.camera)}; gimbald: {words(self.gimbald)}"


class Endurance:
    """The run and its books."""

    def __init__(self, bench, report, seed):
        self.bench, self.report, self.chance = bench, report, random.Random(seed)
        self.calm = dict(seconds=0.0, exposed=0, live=0, lost=0, counted=0, replaced=0)
        self.faults, self.worst = {}, {}
        self.marks = []

    def settle(self, before, seen):
        """(what was counted since `before`, frames that gimbald says it lost, frames that nobody counted)"""
        counted = Counts.take(self.bench).since(before)
        drops = sum(count for key, count in counted.gimbald.items() if key.startswith("drops.") and key != "drops.restarts")
        exposed = counted.camera.get("frames", 0)
        return counted, drops, max(0, exposed - seen.live - drops - seen.replaced - UNDER_WAY)

    def quiet(self, seconds):
        """Nothing is wrong: every frame has to come."""
        before = Counts.take(self.bench)
        seen = self.bench.watch(seconds)
        counted, drops, lost = self.settle(before, seen)
        # More than usual may be under way just then: what is lost stays lost.
        for _ in range(2):
            if lost:
                more, seconds = self.bench.watch(0.5), seconds + 0.5
                seen.live, seen.replaced, seen.gap = seen.live + more.live, seen.replaced + more.replaced, max(seen.gap, more.gap)
                counted, drops, lost = self.settle(before, seen)
        exposed = counted.camera.get("frames", 0)
        books = dict(seconds=seconds, exposed=exposed, live=seen.live, lost=lost, counted=drops, replaced=seen.replaced)
        for key, count in books.items():
            self.calm[key] += count
        if lost or drops:
            self.report.say(f"      without a fault: {drops} of {exposed} frames lost and counted, {seen.replaced} taken too late by the reader, {lost} not counted, longest gap {seen.gap:.2f} s; {counted}")

    def fault(self):
        """One fault, until the picture is live again."""
        fault = self.chance.choice(FAULTS)
        before, began = Counts.take(self.bench), now()
        fault(self.bench, self.chance)
        over = now()
        back = self.bench.watch(RECOVERY, until_live=True)
        took, name = now() - over, fault.__name__
        self.report.say(f"      {name}: lasted {over - began:.1f} s, live {took:.2f} s later; {Counts.take(self.bench).since(before)}")
        if back.live < 2:
            self.report.check(f"live within {RECOVERY:.0f} s after {name}", False)
        self.faults[name] = self.faults.get(name, 0) + 1
        self.worst[name] = max(self.worst.get(name, 0), took)
        self.bench.watch(SETTLED)

    def mark(self):
        daemon = self.bench.daemon
        self.marks.append((daemon.memory(), daemon.descriptors()))

    def run(self, seconds, with_faults):
        end = now() + seconds
        while (began := now()) < end:
            if with_faults:
                self.fault()
            self.quiet(max(1.0, PERIOD - (now() - began)))
            self.mark()
            if len(self.marks) % 30 == 1:
                self.report.say(f"{end - now():.0f} s to go: {self.marks[-1][0]:.1f} MiB, {self.marks[-1][1]} descriptors")
            if not self.bench.daemon.alive():
                self.report.check("the daemon lives", False)
                return

    def tell(self):
        report, calm = self.report, self.calm
        for name in sorted(self.faults):
            report.say(f"      {name:20} {self.faults[name]:3} times, live again after {self.worst[name]:.2f} s at worst")
        rate = calm["live"] / max(1e-9, calm["seconds"])
        report.say(f"      without a fault: {calm['seconds']:.0f} s, {calm['exposed']} frames exposed, {calm['live']} live ({rate:.2f} a second)")
        report.check(f"{calm['lost']} frames lost without a fault that gimbald did not count", calm["lost"] == 0)
        if self.faults:
            report.say(f"      {calm['counted']} lost that it did count: the machine was late; {calm['replaced']} that the reader took too late")
        else:
            report.check(f"{calm['counted']} lost that it did count, {calm['replaced']} that the reader took too late",
                         calm["counted"] + calm["replaced"] == 0)
        # Its first minutes fill its buffers and the rings of what it remembers.
        settled = self.marks[min(len(self.marks) // 4, 12):]
        memory, descriptors = [mark[0] for mark in settled], [mark[1] for mark in settled]
        report.check(f"memory {memory[0]:.1f} MiB then {memory[-1]:.1f}, {max(memory):.1f} at most", memory[-1] <= memory[0] + 4)
        # One more while the last question for its status is still being closed.
        first, last = min(descriptors[:10]), min(descriptors[-10:])
        report.check(f"descriptors {first} then {last}, {max(descriptors)} at most", last <= first and max(descriptors) <= first + 2)


def main():
    p = argparse.ArgumentParser(prog="uvc-endurance", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("program")
    p.add_argument("--pictures", default="")
    p.add_argument("seconds", nargs="?", type=float, default=600.0)
    p.add_argument("seed", nargs="?", type=int, default=1)
    options = p.parse_intermixed_args()
    report = Report()
    bench = Bench(Shared(os.path.abspath(options.program), loopback(), SIZE, options.pictures))
    bench.start_camera("--port", "0")  # the faults look for it there
    device = link("by-id", camera_nodes()[0])
    report.say(f"{options.seconds:.0f} s, seed {options.seed}, {device} at {SIZE[0]}x{SIZE[1]}, {FPS} a second")
    report.check("it offers a picture", bench.start_daemon(f"camera.fps={FPS}", device=device))
    bench.open_reader()
    report.check("the picture is live", bench.watch(15, until_live=True).live > 1)
    bench.watch(3)
    endurance = Endurance(bench, report, options.seed)
    cpu, began = bench.daemon.cpu(), now()
    endurance.run(options.seconds, with_faults=options.seed != 0)
    share = 100 * (bench.daemon.cpu() - cpu) / (now() - began)
    endurance.tell()
    report.say(f"      {share:.1f} % of a core")
    log = bench.said().splitlines()
    report.say(f"      {len(log)} lines of log")
    sent = bench.end()
    report.check(f"it ends well {bench.failed}", not bench.failed)
    report.say(f"      camera: {sent}")
    for line in [line for line in log if "camera closed" in line or "stream ended" in line][-6:] + (log[-60:] if report.failed else []):
        print("     |", line[:300])
    report.end()


if __name__ == "__main__":
    main()
