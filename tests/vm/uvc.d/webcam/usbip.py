"""The wire: USB/IP as vhci_hcd speaks it, over a socket pair (Documentation/usb/usbip_protocol.rst of the kernel).

vhci_hcd is given one end of the pair and takes it for a network connection to a device. It sends requests (URBs) and takes them back
(unlink); each is answered once.
"""
import collections
import socket
import struct
import time

VHCI = "/sys/devices/platform/vhci_hcd.0"
CMD_SUBMIT, CMD_UNLINK, RET_SUBMIT, RET_UNLINK = 1, 2, 3, 4
EPIPE, EPROTO, ECONNRESET, EILSEQ = 32, 71, 104, 84
HEADER = 48
PORT_IS_FREE = "004"

# A request. npackets, offsets (where each packet's data lies, how much it may have): of isochronous ones, else 0 and None.
Urb = collections.namedtuple("Urb", "seq into endpoint length setup data npackets offsets start")


def pieces(parts):
    """sendmsg takes no more than 1024 pieces."""
    return [b"".join(parts)] if len(parts) > 900 else parts


class Wire:
    """The camera's end. `heard` is called with each Urb, `taken_back` with the number of one that is not wanted any more; the latter
    says whether it was still here."""

    def __init__(self, speed, wanted_port, heard, taken_back):
        self.hub, self.code = ("ss", 5) if speed == "super" else ("hs", 3)
        self.wanted_port, self.heard, self.taken_back = wanted_port, heard, taken_back
        self.socket, self.port, self.buffer = None, None, bytearray()

    def attach(self):
        """Plugs the camera into a free port (or the one that is wanted). SystemExit where there is none."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        for end in (ours, theirs):
            for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
                end.setsockopt(socket.SOL_SOCKET, option, 4 << 20)
        for _ in range(50):
            for port in self.free_ports():
                try:
                    with open(VHCI + "/attach", "w") as file:
                        file.write(f"{port} {theirs.fileno()} {0x10000 + port + 1} {self.code}")
                except OSError:
                    continue
                theirs.close()
                self.socket, self.port, self.buffer = ours, port, bytearray()
                return
            time.sleep(0.1)
        raise SystemExit("webcam: no free port at vhci_hcd")

    def free_ports(self):
        with open(VHCI + "/status") as file:
            fields = [line.split() for line in file if line.startswith(self.hub)]
        free = [int(words[1]) for words in fields if words[2] == PORT_IS_FREE]
        return [port for port in free if self.wanted_port in (None, port % 8)]

    def detach(self):
        try:
            with open(VHCI + "/detach", "w") as file:
                file.write(str(self.port))
        except OSError:
            pass  # the other end went first

    def close(self):
        self.socket.close()
        self.socket = None

    def receive(self):
        """Takes what came and hands out the whole requests in it. False: the other end is gone."""
        try:
            data = self.socket.recv(1 << 16)
        except OSError:
            data = b""
        self.buffer += data
        while data and (used := self.one()):
            del self.buffer[:used]
        return bool(data)

    def one(self):
        """Hands out the first request of the buffer; says how many bytes it had, 0 where it is not whole yet."""
        if len(self.buffer) < HEADER:
            return 0
        command, seq, _, into, endpoint = struct.unpack_from(">IIIII", self.buffer)
        if command == CMD_UNLINK:
            victim = struct.unpack_from(">I", self.buffer, 20)[0]
            status = -ECONNRESET if self.taken_back(victim) else 0
            self.send([struct.pack(">IIIIIi", RET_UNLINK, seq, 0, 0, 0, status) + bytes(24)])
            return HEADER
        if command != CMD_SUBMIT:
            raise SystemExit(f"webcam: vhci_hcd said {command:#x}")
        _, length, start, npackets, _ = struct.unpack_from(">IiiiI", self.buffer, 20)
        npackets = max(0, npackets)
        out = 0 if into else length
        total = HEADER + out + 16 * npackets
        if len(self.buffer) < total:
            return 0
        setup, data = bytes(self.buffer[40:HEADER]), bytes(self.buffer[HEADER:HEADER + out])
        offsets = None
        if npackets:
            numbers = struct.unpack_from(f">{4 * npackets}I", self.buffer, HEADER + out)
            offsets = numbers[0::4], numbers[1::4]
        self.heard(Urb(seq, into, endpoint, length, setup, data, npackets, offsets, start))
        return total

    def send(self, parts):
        """Sends an answer. That the other end is gone is seen when the socket is read the next time."""
        if not self.socket:
            return
        try:
            total = sum(len(part) for part in parts)
            sent = self.socket.sendmsg(parts)
            if sent < total:
                self.socket.sendall(b"".join(parts)[sent:])
        except OSError:
            pass

    def reply(self, urb, status, parts=(), actual=None, packets=None):
        """Answers a request. `packets`: for each isochronous packet, how much it has and its status."""
        parts = pieces(list(parts))
        length = sum(len(part) for part in parts) if actual is None else actual
        errors, tail = 0, b""
        if urb.npackets:
            packets = packets or [(0, status)] * urb.npackets
            errors = sum(state != 0 for _, state in packets)
            rows = ((at, most, got, state) for at, most, (got, state) in zip(*urb.offsets, packets))
            tail = struct.pack(">" + "IIIi" * urb.npackets, *[number for row in rows for number in row])
        head = struct.pack(">IIIII", RET_SUBMIT, urb.seq, 0, 0, 0)
        head += struct.pack(">iiiiI", status, length, urb.start, urb.npackets, errors) + bytes(8)
        self.send([head, *parts] + ([tail] if tail else []))
