"""Cameras with several nodes: the one with the picture is used, by name and by auto, and found again."""
from dataclasses import dataclass

from bench import CARD, Case, camera_nodes, capture_nodes


@dataclass
class Nodes:
    """The camera's streams in the order of their nodes; the one with the picture is at `picture` among its capture nodes."""

    device: str
    options: tuple
    picture: int

    def run(self, bench):
        bench.start_camera(*self.options)
        if not bench.check("it offers a picture", bench.start_daemon("camera.format=auto", device=self.device)):
            return
        bench.open_reader()
        bench.check("the picture is live", bench.live_within(15))
        self.right(bench, "at first")
        bench.webcam("unplug")
        bench.watch(2)
        bench.webcam("plug")
        bench.check("the picture is live again", bench.live_within(8))
        self.right(bench, "after it was unplugged")

    def right(self, bench, when):
        nodes, used = capture_nodes("1-1"), bench.camera_in_use()
        bench.note(f"{when}: {used} of {nodes}, metadata at {[node for node in camera_nodes('1-1') if node not in nodes]}")
        bench.check(f"{when}: {used} is the node with the picture", used == nodes[self.picture])
        bench.check(f"{when}: in colour", bench.status().get("camera", {}).get("format") != "GREY")


H264_FIRST = ("--second", "H264", "--second-first")
GREY_FIRST = ("--second", "GREY:640x480", "--second-first")
GREY_FIRST_ALL_SIZES = ("--second", "GREY", "--second-first")
GREY_AFTER = ("--second", "GREY")
CASES = [
    Case(f"{name}-{'auto' if device == 'auto' else 'name'}", Nodes(device, options, picture).run)
    for name, options, picture in (
        ("nodes-h264-first", H264_FIRST, 1), ("nodes-grey-first", GREY_FIRST, 1), ("nodes-grey-first-all-sizes", GREY_FIRST_ALL_SIZES, 1),
        ("nodes-grey-after", GREY_AFTER, 0))
    for device in (CARD, "auto")
]
