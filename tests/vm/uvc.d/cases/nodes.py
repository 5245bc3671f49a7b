"""Cameras with several nodes: the one with the picture is used, by name and by auto, and found again."""
from dataclasses import dataclass

from scene import CARD, Case, camera_nodes, capture_nodes


@dataclass
class Nodes:
    """The camera's streams in the order of their nodes; the one with the picture is at `picture` among its capture nodes."""

    device: str
    options: tuple
    picture: int

    def play(self, scene):
        scene.start_camera(*self.options)
        if not scene.check("it offers a picture", scene.start_daemon("camera.format=auto", device=self.device)):
            return
        scene.open_reader()
        scene.check("the picture is live", scene.live_within(15))
        self.right(scene, "at first")
        scene.webcam("unplug")
        scene.watch(2)
        scene.webcam("plug")
        scene.check("the picture is live again", scene.live_within(8))
        self.right(scene, "after it was unplugged")

    def right(self, scene, when):
        nodes, used = capture_nodes("1-1"), scene.camera_in_use()
        scene.note(f"{when}: {used} of {nodes}, metadata at {[node for node in camera_nodes('1-1') if node not in nodes]}")
        scene.check(f"{when}: {used} is the node with the picture", used == nodes[self.picture])
        scene.check(f"{when}: in colour", scene.status().get("camera", {}).get("format") != "GREY")


H264_FIRST = ("--second", "H264", "--second-first")
GREY_FIRST = ("--second", "GREY:640x480", "--second-first")
GREY_FIRST_ALL_SIZES = ("--second", "GREY", "--second-first")
GREY_AFTER = ("--second", "GREY")
CASES = [
    Case(f"{name}-{'auto' if device == 'auto' else 'name'}", Nodes(device, options, picture).play)
    for name, options, picture in (
        ("nodes-h264-first", H264_FIRST, 1), ("nodes-grey-first", GREY_FIRST, 1), ("nodes-grey-first-all-sizes", GREY_FIRST_ALL_SIZES, 1),
        ("nodes-grey-after", GREY_AFTER, 0))
    for device in (CARD, "auto")
]
