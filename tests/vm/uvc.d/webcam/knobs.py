"""What can be wrong with the camera, or asked of it, while it runs."""

# name: (default, meaning). A chance is 0 to 1, for each frame. The default's type is the type of every value.
KNOBS = {
    # the picture
    "huffman": (1, "0: JPEG without Huffman tables (AVI1), as many webcams send"),
    "trailing": (0, "random bytes after each JPEG's end"),
    "zeros": (0, "zero bytes after each JPEG's end"),
    "app4": (0, "random bytes in APP4 segments before the picture (a C920's muxed H.264)"),
    "doublesoi": (0, "1: a second SOI and a comment before the picture"),
    "nojpeg": (0, "1: random bytes in place of each JPEG"),
    "corrupt": (0.0, "chance that bytes in the middle of the picture are flipped"),
    "cut": (0.0, "chance that a frame ends halfway (JPEG without end, YUYV too short)"),
    "empty": (0.0, "chance that a frame has no byte"),
    "othersize": ("", "WxH: JPEGs of this size, whatever was agreed; or +ROWS: the header says so many rows more"),
    "firstbad": (0, "so many frames after a start are random bytes"),
    "big": (0, "zero bytes after the picture, beyond what dwMaxVideoFrameSize says is possible"),
    # the payloads
    "error": (0.0, "chance that one of a frame's payloads has the ERR bit"),
    "drop": (0.0, "chance that one of a frame's payloads is lost"),
    "iso_error": (0.0, "isochronous: chance that the bus reports a damaged packet in a frame"),
    "noeof": (0, "1: EOF is never set; only FID tells frames apart"),
    "nofid": (0, "1: FID stays 0; only EOF tells frames apart"),
    "pts": ("ok", "ok, none (2-byte headers), zero, wild"),
    "badheader": (0.0, "chance that one of a frame's payloads says an impossible header length"),
    # the times
    "slow": (1.0, "so many times the agreed interval between frames"),
    "dark": (0, "1: the room is dark; with exposure_dynamic_framerate set the rate is halved"),
    "pause": (0.0, "seconds without a frame from now on, once"),
    "hang": (0, "1: no more frames until the stream is started again; 2: for ever"),
    "late": (0.0, "seconds from the start of the stream to the first frame"),
    "skip": (0, "1: frames that the host is too slow for are not sent (sensors do so); 0: they come late"),
    # the bus and the requests
    "urb_error": (0, "so many transfers end with EPROTO from now on, as at a glitch of the bus; uvcvideo has 5 under way"),
    "stall_probe": (0, "so many SET_CUR(probe) are refused with STALL"),
    "stall_commit": (0, "so many SET_CUR(commit) are refused with STALL"),
    "stall_alt": (0, "so many SET_INTERFACE that start the stream are refused with STALL (isochronous)"),
    "stall_controls": (0, "1: every request to the camera's controls is refused"),
    "probe_fixed": ("", "FORMAT:FRAME, 1:2 say: the camera answers this mode whatever is asked"),
    "maxframe": (0, "dwMaxVideoFrameSize as it is told (bytes); 0: the truth"),
}


class Knobs(dict):
    """The knobs' values now."""

    def __init__(self):
        super().__init__({name: default for name, (default, _) in KNOBS.items()})

    def turn(self, name, value):
        """Sets one from its text. ValueError says what is wrong with it."""
        if name not in KNOBS:
            raise ValueError(f"no knob {name}")
        kind = type(KNOBS[name][0])
        try:
            self[name] = kind(value)
        except ValueError:
            raise ValueError(f"{name} wants a {kind.__name__}") from None

    def turned(self):
        """Those that are not as they were at first."""
        return {name: value for name, value in self.items() if value != KNOBS[name][0]}
