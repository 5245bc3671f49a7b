"""The camera's USB descriptors: UVC 1.1, one or two streams, isochronous or bulk.

Field names and numbers are those of the USB Device Class Definition for Video Devices 1.1, chapter 3.
"""
import struct

TEN_MILLION = 10_000_000  # frame intervals are counted in 100 ns
GUID_TAIL = bytes.fromhex("0000 1000 8000 00aa00389b71")
# name: (first four bytes of the GUID, bits a pixel, bytes a frame of so many pixels)
RAW = {"YUYV": (b"YUY2", 16, lambda n: n * 2), "NV12": (b"NV12", 12, lambda n: n * 3 // 2), "GREY": (b"Y800", 8, lambda n: n)}
COMPRESSED = ("MJPG", "H264")

# Endpoint sizes of the isochronous alternate settings 1, 2, ...; bits 11 and 12: more packets in a microframe.
ALTERNATES = [128, 512, 1024, 0x0C00, 0x1400]

CAMERA_TERMINAL, PROCESSING_UNIT = 1, 2
# Bit n: the control of selector n + 1 (camera terminal) or as table 3-8 has it (processing unit): see controls.py.
CAMERA_CONTROLS = 0x040A0E | 0x20000
PROCESSING_CONTROLS = 0x175B


def packet_bytes(size):
    """How much a microframe carries at an endpoint of that wMaxPacketSize."""
    return (size & 0x7FF) * (1 + (size >> 11 & 3))


def frame_bytes(name, width, height):
    """The most that a frame of a format has."""
    return RAW[name][2](width * height) if name in RAW else width * height * 2


def parse_sizes(text):
    """[(width, height)] of `640x480,1280x720`."""
    return [tuple(int(number) for number in size.split("x")) for size in text.split(",")]


class Modes:
    """What a stream offers: formats, each with frames (width, height, intervals), as the descriptors number them (from 1)."""

    def __init__(self, formats, sizes, options):
        self.continuous = options.continuous
        self.formats = []
        for name in formats.split(","):
            frames = [(w, h, self.intervals(name, w, h, options)) for w, h in parse_sizes(sizes)]
            self.formats.append((name, frames))

    @staticmethod
    def intervals(name, width, height, options):
        usual = [333333, 666666]
        if name == "YUYV" and not options.bulk:  # what fits into high speed's 24 MB/s
            return usual if width * height <= 640 * 480 else {1920: [2000000]}.get(width, [1000000])
        if options.fps60 and name == "MJPG" and width <= 1280:
            return [166666] + usual
        return usual

    def descriptors(self):
        return b"".join(self.format(index, *entry) for index, entry in enumerate(self.formats, 1))

    def format(self, index, name, frames):
        if name == "MJPG":
            out, kind = struct.pack("<11B", 11, 0x24, 0x06, index, len(frames), 1, 1, 0, 0, 0, 0), 0x07
        elif name in RAW:
            code, bits, _ = RAW[name]
            out = struct.pack("<5B16s6B", 27, 0x24, 0x04, index, len(frames), code + GUID_TAIL, bits, 1, 0, 0, 0, 0)
            kind = 0x05
        else:  # frame based
            guid = name.encode() + GUID_TAIL
            out, kind = struct.pack("<5B16s7B", 28, 0x24, 0x10, index, len(frames), guid, 0, 1, 0, 0, 0, 0, 1), 0x11
        out += b"".join(self.frame(kind, number, *frame) for number, frame in enumerate(frames, 1))
        if kind != 0x11:
            out += struct.pack("<6B", 6, 0x24, 0x0D, 1, 1, 4)  # colours: BT.709, BT.709, BT.601
        return out

    def frame(self, kind, number, width, height, intervals):
        if self.continuous:
            count, table = 0, struct.pack("<III", min(intervals), max(intervals), 1)
        else:
            count, table = len(intervals), struct.pack(f"<{len(intervals)}I", *intervals)
        bits = width * height * 16 * (TEN_MILLION // min(intervals))
        head = (26 + len(table), 0x24, kind, number, 0, width, height)
        if kind == 0x11:
            return struct.pack("<5BHHIIIBI", *head, bits // 10, bits // 10, intervals[0], count, 0) + table
        return struct.pack("<5BHHIIIIB", *head, bits // 60, bits, width * height * 2, intervals[0], count) + table


def companion(options, bytes_per_interval=0):
    """The SuperSpeed endpoint companion, where the speed wants one."""
    return struct.pack("<BBBBH", 6, 0x30, 0, 0, bytes_per_interval) if options.speed == "super" else b""


def device(options):
    super_speed = options.speed == "super"
    return struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x0300 if super_speed else 0x0200, 0xEF, 2, 1, 9 if super_speed else 64,
                       options.vendor, options.product, 0x0100, 1, 2, 3 if options.serial else 0, 1)


def video_control(options, streams):
    """The control interface: one camera terminal, one processing unit, an output terminal for each stream, a status endpoint."""
    none = options.nocontrols
    terminal_bits, unit_bits = (0, 0) if none else (CAMERA_CONTROLS, PROCESSING_CONTROLS)
    units = struct.pack("<BBBBHBBHHHB3s", 18, 0x24, 2, CAMERA_TERMINAL, 0x0201, 0, 0, 0, 0, 0, 3, terminal_bits.to_bytes(3, "little"))
    units += struct.pack("<BBBBBHBHBB", 12, 0x24, 5, PROCESSING_UNIT, CAMERA_TERMINAL, 0, 2, unit_bits, 0, 0)
    for n in range(streams):
        units += struct.pack("<BBBBHBBB", 9, 0x24, 3, 3 + n, 0x0101, 0, PROCESSING_UNIT, 0)
    size = 12 + streams
    head = struct.pack("<BBBHHIB", size, 0x24, 1, 0x0110, size + len(units), 48000000, streams) + bytes(range(1, 1 + streams))
    endpoint = struct.pack("<BBBBHB", 7, 5, 0x83, 3, 16, 8 if options.speed == "super" else 6)
    endpoint += companion(options, 16) + struct.pack("<BBBH", 5, 0x25, 3, 16)
    return struct.pack("<9B", 9, 4, 0, 0, 1, 0x0E, 1, 0, 2) + head + units + endpoint


def video_streaming(options, n, modes):
    """The streaming interface number `n`, from 0."""
    number, endpoint, body, formats = 1 + n, 0x81 + n, modes.descriptors(), len(modes.formats)
    header = struct.pack("<BBBBHBBBBBBB", 13 + formats, 0x24, 1, formats, 13 + formats + len(body), endpoint, 0, 3 + n, 0, 0, 0, 1)
    header += bytes(formats)
    if options.bulk:
        out = struct.pack("<9B", 9, 4, number, 0, 1, 0x0E, 2, 0, 0) + header + body
        return out + struct.pack("<BBBBHB", 7, 5, endpoint, 2, 1024 if options.speed == "super" else 512, 0) + companion(options)
    out = struct.pack("<9B", 9, 4, number, 0, 0, 0x0E, 2, 0, 0) + header + body
    for alternate, size in enumerate(ALTERNATES, 1):
        out += struct.pack("<9B", 9, 4, number, alternate, 1, 0x0E, 2, 0, 0)
        out += struct.pack("<BBBBHB", 7, 5, endpoint, 5, size, 1)
    return out


def configuration(options, modes):
    body = struct.pack("<8B", 8, 11, 0, 1 + len(modes), 0x0E, 3, 0, 2) + video_control(options, len(modes))
    body += b"".join(video_streaming(options, n, one) for n, one in enumerate(modes))
    power = 100 if options.speed == "super" else 250
    return struct.pack("<BBHBBBBB", 9, 2, 9 + len(body), 1 + len(modes), 1, 0, 0x80, power) + body


def string(text):
    """A string descriptor."""
    raw = text.encode("utf-16-le")[:252]
    return bytes([2 + len(raw), 3]) + raw
