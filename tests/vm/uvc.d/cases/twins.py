"""Two cameras of one kind: gimbald has one, and never opens the other, whatever is unplugged and in whatever order they come back.

The twin counts what it is asked: after it was plugged in, nobody may have negotiated with it.
"""
import os
from dataclasses import dataclass

from bench import CARD, SERIAL, TWIN, Case, camera_nodes, link, socket_of

GONE = 2.5  # seconds of each step: time for several tries to find a camera
AWAY = 14  # longer than "auto" waits for the camera that it had


@dataclass
class Twins:
    """A case: how the setting names ours; whether the two have serial numbers that differ."""

    naming: str
    serials: tuple = (SERIAL, TWIN)

    def run(self, bench):
        # Ours is the one in socket 0.
        bench.start_camera("--port", "0", "--serial", self.serials[0])
        first = camera_nodes("1-1")[0]
        device = {"number": first[10:], "node": first, "name": CARD, "auto": "auto"}.get(self.naming) or link(self.naming, first)
        # By its name alone ours can only be meant where it is alone.
        plug_twin = lambda: bench.start_camera("--port", "1", "--serial", self.serials[1], name="twin")
        if self.naming != "name":
            plug_twin()
        bench.note(f"camera.device={device}")
        if not bench.check("it offers a picture", bench.start_daemon(device=device)):
            return
        bench.open_reader()
        bench.check("the picture is live", bench.live_within(15))
        if self.naming == "name":
            plug_twin()
            bench.watch(1)
        # Where their serial numbers do not differ, udev's one link by-id leads to either.
        either = self.naming == "by-id" and self.serials[0] == self.serials[1]
        swapped = either and socket_of(bench.camera_in_use()) == "1-2"
        pair = Pair(bench, *(("twin", "cam") if swapped else ("cam", "twin")))
        self.orders(pair)
        bench.check("the daemon lives", bench.daemon.alive())

    def orders(self, pair):
        pair.order("ours goes and comes", ["out ours"], ["in ours"])
        pair.order("both go, the twin comes first", ["out ours", "out twin"], ["in twin"], ["in ours"])
        pair.order("both go, ours comes first", ["out twin", "out ours"], ["in ours"], ["in twin"])
        pair.order("the twin goes, then ours, the twin comes", ["out twin"], ["out ours"], ["in twin"], ["in ours"])
        pair.order("both go and come at once", ["out ours", "out twin", "in twin", "in ours"])
        if self.serials[0] != self.serials[1]:
            self.sockets_change(pair)
        if self.naming == "auto":
            self.ours_stays_away(pair)

    def sockets_change(self, pair):
        """A serial number goes with its camera; a path is that of a socket."""
        stays = self.naming != "by-path"
        pair.order("ours comes into another socket", ["out ours"], ["socket ours 4", "in ours"], live=stays)
        pair.order("the twin comes into our socket, ours into its", ["out twin", "out ours"], ["socket twin 0", "in twin"],
                   ["socket ours 1", "in ours"], live=stays)

    @staticmethod
    def ours_stays_away(pair):
        """In the end it has to take another, and says so."""
        pair.move("out ours")
        pair.bench.watch(AWAY)
        bench = pair.bench
        bench.check("the picture is live, of the twin", bench.watch(10, until_live=True).live > 1)
        bench.check("it says that it took another camera", "using another camera" in bench.said())


class Pair:
    """The two cameras of a bench, and what has to hold of them at any time."""

    def __init__(self, bench, ours, twin):
        self.bench, self.names = bench, {"ours": ours, "twin": twin}
        stats = bench.stats(twin)
        # The driver itself negotiates with a camera that is plugged in.
        self.usual = stats["probes"] // stats["plugs"]

    def move(self, *words):
        """`out ours`, `in twin`, `socket ours 3`: one after the other."""
        for word in words:
            what, which, *where = word.split()
            command = {"out": ["unplug"], "in": ["plug"], "socket": ["set", f"port={''.join(where)}"]}[what]
            self.bench.webcam(*command, name=self.names[which])

    def order(self, what, *steps, live=True):
        """Takes the steps, with time for gimbald to do wrong after each. `live`: ours has to be used in the end, else nothing."""
        for step in steps:
            self.move(*step)
            self.bench.watch(GONE)
        if live:
            self.bench.check(f"{what}: live again", self.bench.watch(10, until_live=True).live > 1)
        in_use = self.bench.camera_in_use()
        self.bench.note(f"{what}: {in_use and os.path.realpath(in_use)} in socket {socket_of(in_use)}")
        stats = self.bench.stats(self.names["twin"])
        # Less than usual, where it was unplugged again at once.
        probed = max(0, stats.get("probes", 0) - self.usual * stats["plugs"])
        asked = probed, stats.get("commits", 0), stats.get("starts", 0)
        self.bench.check(f"{what}: the twin is left alone, not probed {asked[0]}, committed {asked[1]}, started {asked[2]} times",
                         asked == (0, 0, 0))


class OneOrder(Twins):
    """The shortest: ours goes and comes."""

    def orders(self, pair):
        pair.order("ours goes and comes", ["out ours"], ["in ours"])
        pair.order("both go, the twin comes first", ["out ours", "out twin"], ["in twin"], ["in ours"])


NAMINGS = ("by-id", "by-path", "number", "node", "name", "auto")
CASES = [Case("twin-must-not-be-taken", OneOrder("by-id").run, core=True)]
CASES += [Case(f"twin-{naming}", Twins(naming).run) for naming in NAMINGS]
CASES += [Case(f"twin-{naming}-without-serials", Twins(naming, ("", "")).run) for naming in NAMINGS]
CASES += [Case("twin-by-id-equal-serials", Twins("by-id", (SERIAL, SERIAL)).run)]
