"""What the knobs make of a picture, and of its payloads."""
import struct

from . import jpeg
from .usbip import EILSEQ

END_OF_FRAME, ERROR, END_OF_HEADER, PTS_AND_SCR = 0x02, 0x40, 0x80, 0x0C
CLOCK = 48_000_000  # dwClockFrequency


def picture(stream, knobs, chance, pictures, counts):
    """The stream's next frame, as the knobs have it."""
    frame = stream.frames[stream.number % len(stream.frames)]
    if stream.format == "MJPG":
        frame = compressed(frame, stream, knobs, chance, pictures)
    if chance.random() < knobs["corrupt"]:
        changed = bytearray(frame)
        for _ in range(8):
            changed[chance.randrange(len(changed) // 3, len(changed) * 2 // 3)] ^= chance.randrange(1, 255)
        frame = bytes(changed)
        counts["corrupted"] += 1
    if chance.random() < knobs["cut"]:
        frame = frame[:len(frame) // 2]
        counts["cut"] += 1
    if chance.random() < knobs["empty"]:
        frame = b""
        counts["emptied"] += 1
    if stream.number < knobs["firstbad"]:
        frame = chance.randbytes(4000)
    if knobs["big"]:
        frame = bytes(frame) + bytes(knobs["big"])
    return memoryview(frame)


def compressed(frame, stream, knobs, chance, pictures):
    """A JPEG as the knobs have it."""
    if knobs["nojpeg"]:
        return chance.randbytes(4000)
    other = knobs["othersize"]
    if other.startswith("+"):
        frame = jpeg.with_rows(frame, stream.size[1] + int(other))
    elif other:
        frames = pictures.frames("MJPG", *(int(number) for number in other.split("x")))
        frame = frames[stream.number % len(frames)]
    if not knobs["huffman"]:
        frame = jpeg.without_huffman_tables(frame)
    if knobs["app4"]:
        frame = jpeg.with_app4(frame, chance.randbytes(knobs["app4"]))
    if knobs["doublesoi"]:
        frame = jpeg.with_second_soi(frame)
    return frame + chance.randbytes(knobs["trailing"]) + bytes(knobs["zeros"])


def payloads(stream, frame, now, knobs, chance, counts):
    """The frame as payloads: header, data, status on the bus."""
    bits = END_OF_HEADER | (0 if knobs["nofid"] else stream.frame_id)
    stream.frame_id ^= 1
    bare = knobs["pts"] == "none"
    room = stream.payload - (2 if bare else 12)
    total = max(1, -(-len(frame) // room))
    taken = int((now - 0.01) * CLOCK) & 0xFFFFFFFF
    taken = {"zero": 0, "wild": chance.getrandbits(32)}.get(knobs["pts"], taken)

    def hit(knob):
        """Which payload it hits; -1: none."""
        return chance.randrange(total) if chance.random() < knobs[knob] else -1

    bad, odd, lost, hurt = hit("error"), hit("badheader"), hit("drop"), hit("iso_error")
    for index in range(total):
        flags = bits | (END_OF_FRAME if index == total - 1 and not knobs["noeof"] else 0) | (ERROR if index == bad else 0)
        counts["error_bits"] += index == bad
        if index == lost:
            counts["lost_payloads"] += 1
            continue
        if bare:
            header = bytes([2, flags])
        else:
            header = struct.pack("<BBI", 12, flags | PTS_AND_SCR, taken) + source_clock(knobs["pts"], now, chance)
        if index == odd:
            header = bytes([chance.choice([0, 1, 255])]) + header[1:]
            counts["bad_headers"] += 1
        yield header, frame[index * room:(index + 1) * room], -EILSEQ if index == hurt else 0


def source_clock(kind, now, chance):
    """The header's SCR: the device's clock and the bus's frame number."""
    if kind == "wild":
        return struct.pack("<IH", chance.getrandbits(32), chance.getrandbits(11))
    if kind == "zero":
        return bytes(6)
    return struct.pack("<IH", int(now * CLOCK) & 0xFFFFFFFF, int(now * 1000) & 0x7FF)
