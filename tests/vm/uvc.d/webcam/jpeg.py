"""A JPEG's segments, as far as the camera changes them."""
import struct

SOI, EOI = b"\xff\xd8", b"\xff\xd9"
FRAME_HEADERS = (0xC0, 0xC1, 0xC2)
HUFFMAN_TABLES, SCAN = 0xC4, 0xDA


def segments(jpeg):
    """(marker, start, end) of the segments up to the scan."""
    at = 2
    while at + 4 <= len(jpeg) and jpeg[at] == 0xFF:
        marker, length = jpeg[at + 1], struct.unpack_from(">H", jpeg, at + 2)[0]
        yield marker, at, at + 2 + length
        at += 2 + length
        if marker == SCAN:
            return


def split(stream):
    """The pictures of a motion JPEG file."""
    pieces = stream.split(EOI + SOI)
    last = len(pieces) - 1
    return [(SOI if i else b"") + piece + (EOI if i < last else b"") for i, piece in enumerate(pieces)]


def with_rows(jpeg, rows):
    """The same with another height in its header."""
    changed = bytearray(jpeg)
    for marker, at, _ in segments(jpeg):
        if marker in FRAME_HEADERS:
            struct.pack_into(">H", changed, at + 5, rows)
    return bytes(changed)


def without_huffman_tables(jpeg):
    out, last = [SOI], 2
    for marker, at, end in segments(jpeg):
        if marker != HUFFMAN_TABLES:
            out.append(jpeg[at:end])
        last = end
    return b"".join(out) + jpeg[last:]


def with_app4(jpeg, payload):
    """The same with `payload` in APP4 segments before all else."""
    extra = b""
    for at in range(0, len(payload), 65000):
        piece = payload[at:at + 65000]
        extra += b"\xff\xe4" + struct.pack(">H", len(piece) + 2) + piece
    return jpeg[:2] + extra + jpeg[2:]


def with_second_soi(jpeg):
    return SOI + b"\xff\xfe\x00\x06test" + jpeg[2:]
