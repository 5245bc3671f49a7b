"""The camera: what it answers to the host's requests, its plug, and what it is told while it runs."""
import collections
import json
import random
import selectors
import struct
import time

from . import descriptors
from .controls import GET_CUR, GET_DEF, GET_INFO, GET_LEN, GET_MAX, GET_MIN, PRIVACY, SET_CUR, controls
from .knobs import Knobs
from .pictures import Pictures
from .stream import PROBE_BYTES, Stream
from .usbip import EPIPE, Wire

# Standard requests of USB 2.0, chapter 9.
GET_STATUS, CLEAR_FEATURE, SET_FEATURE, SET_ADDRESS, GET_DESCRIPTOR = 0, 1, 3, 5, 6
GET_CONFIGURATION, SET_CONFIGURATION, GET_INTERFACE, SET_INTERFACE = 8, 9, 10, 11
SET_SEL, SET_ISOCH_DELAY = 48, 49
ACCEPTED = (CLEAR_FEATURE, SET_FEATURE, SET_ADDRESS, SET_CONFIGURATION, SET_SEL, SET_ISOCH_DELAY)
TYPE_MASK, STANDARD, CLASS, TO_ENDPOINT, FROM_DEVICE = 0x60, 0x00, 0x20, 0x02, 0x80
# What the control interface says of a request that it refused.
WRONG_UNIT, INVALID_REQUEST = 6, 7
PROBE, COMMIT = 1, 2
ERROR_CODE = 2
STATUS_ENDPOINT = 3


class Camera:
    """The device. `serve` runs it until it is told to end."""

    def __init__(self, options):
        self.options, self.knobs = options, Knobs()
        self.chance, self.counts = random.Random(options.seed), collections.Counter()
        self.pictures, self.controls = Pictures(options.pictures, options.count), controls()
        modes = [descriptors.Modes(options.formats, options.sizes, options)]
        if options.second:
            formats, _, sizes = options.second.partition(":")
            second = descriptors.Modes(formats, sizes or options.sizes, options)
            modes = [second, *modes] if options.second_first else [*modes, second]
        self.device, self.configuration = descriptors.device(options), descriptors.configuration(options, modes)
        self.wire = Wire(options.speed, options.port, self.submitted, self.unlinked)
        self.paused_until, self.refusal, self.ended = 0.0, 0, False
        self.interrupts = collections.deque()
        self.streams = [Stream(n, one, self) for n, one in enumerate(modes)]
        self.selector = selectors.DefaultSelector()

    def make_pictures(self):
        """Makes the compressed pictures before anybody waits for them; raw ones, which are large, are made when they are wanted."""
        for stream in self.streams:
            for name, frames in stream.modes.formats:
                for width, height, _ in frames if name in descriptors.COMPRESSED else ():
                    self.pictures.frames(name, width, height)

    # -- the plug

    def plug(self):
        if self.wire.socket:
            return
        self.wire.attach()
        self.counts["plugs"] += 1
        self.interrupts.clear()
        for stream in self.streams:
            stream.reset()
        self.selector.register(self.wire.socket, selectors.EVENT_READ, self.receive)

    def unplug(self):
        if self.wire.socket:
            self.wire.detach()
            self.selector.unregister(self.wire.socket)
            self.wire.close()

    def receive(self):
        if not self.wire.receive():  # unplugged from the other side
            self.selector.unregister(self.wire.socket)
            self.wire.close()

    # -- requests

    def submitted(self, urb):
        if urb.endpoint == 0:
            self.control(urb)
        elif urb.endpoint == STATUS_ENDPOINT:
            self.interrupts.append(urb)
        elif urb.endpoint - 1 < len(self.streams):
            stream = self.streams[urb.endpoint - 1]
            stream.urbs.append(urb)
            if self.options.bulk and not stream.on:
                stream.start()
        else:
            self.wire.reply(urb, -EPIPE)

    def unlinked(self, victim):
        for waiting in [stream.urbs for stream in self.streams] + [self.interrupts]:
            for urb in waiting:
                if urb.seq == victim:
                    waiting.remove(urb)
                    return True
        return False

    def control(self, urb):
        kind, request, value, index, _ = struct.unpack("<BBHHH", urb.setup)
        answer = self.asked(kind, request, value, index, urb.data)
        if answer is None:
            self.counts["stalls"] += 1
            self.wire.reply(urb, -EPIPE)
        elif kind & FROM_DEVICE:
            self.wire.reply(urb, 0, [answer[:urb.length]])
        else:
            self.wire.reply(urb, 0, actual=len(urb.data))

    def asked(self, kind, request, value, index, data):
        """The answer to a control request; None is a STALL."""
        if kind & TYPE_MASK == STANDARD:
            return self.asked_standard(kind, request, value, index)
        if kind & TYPE_MASK != CLASS:
            return None
        interface, entity, selector = index & 0xFF, index >> 8, value >> 8
        if interface == 0:
            return self.asked_control(request, entity, selector, data)
        if interface <= len(self.streams) and selector in (PROBE, COMMIT):
            return self.asked_stream(self.streams[interface - 1], request, selector, data)
        return None

    def asked_standard(self, kind, request, value, index):
        stream = self.streams[index - 1] if 1 <= index <= len(self.streams) else None
        if request == GET_DESCRIPTOR:
            return self.descriptor(value >> 8, value & 0xFF)
        if request == GET_STATUS:
            return b"\0\0"
        if request == GET_CONFIGURATION:
            return b"\1"
        if request == GET_INTERFACE:
            return bytes([stream.alternate if stream else 0])
        if request == SET_INTERFACE:
            return self.set_interface(stream, value) if stream else b""
        if request == CLEAR_FEATURE and kind == TO_ENDPOINT:  # of HALT: how uvcvideo ends a bulk stream
            for stream in self.streams:
                if index & 0xF == 1 + stream.n:
                    stream.stop()
        return b"" if request in ACCEPTED else None

    def set_interface(self, stream, alternate):
        if alternate and self.refuses("stall_alt"):
            return None
        stream.stop()
        stream.alternate = alternate
        if alternate and not self.options.bulk:
            stream.start()
        return b""

    def refuses(self, knob):
        """Whether a request is refused that so many times is to be."""
        refused = self.knobs[knob] > 0
        self.knobs[knob] -= refused
        return refused

    def descriptor(self, kind, index):
        if kind == 1:
            return self.device
        if kind == 2:
            return self.configuration
        if kind == 3 and index == 0:
            return b"\4\3\x09\4"
        text = {1: "Gimbald", 2: self.options.card, 3: self.options.serial}.get(index) if kind == 3 else None
        return descriptors.string(text) if text is not None else None

    def asked_control(self, request, entity, selector, data):
        if entity == 0:
            if selector == ERROR_CODE and request == GET_CUR:
                return bytes([self.refusal])
            return b"\3" if request == GET_INFO else None
        control = self.controls.get((entity, selector))
        if control is None or self.knobs["stall_controls"]:
            self.refusal = WRONG_UNIT
            return None
        if request == SET_CUR:
            control.now = int.from_bytes(data[:control.size], "little")
            return b""
        answer = control.get(request)
        self.refusal = INVALID_REQUEST if answer is None else 0
        return answer

    def asked_stream(self, stream, request, selector, data):
        if request == SET_CUR:
            if self.refuses("stall_probe" if selector == PROBE else "stall_commit"):
                return None
            stream.probe = stream.answer(data)
            self.counts["probes" if selector == PROBE else "commits"] += 1
            if selector == COMMIT:
                stream.commit = stream.probe
            return b""
        if request == GET_LEN:
            return struct.pack("<H", PROBE_BYTES)
        if request == GET_INFO:
            return b"\3"
        if request in (GET_CUR, GET_MIN, GET_MAX, GET_DEF):
            return stream.probe if selector == PROBE else stream.commit
        return None

    # -- being told

    def told(self, line):
        """What comes of a line of the control socket."""
        word, _, rest = line.partition(" ")
        try:
            if word == "set":
                for pair in rest.split():
                    self.set(*pair.partition("=")[::2])
            elif word == "stats":
                return json.dumps(self.stats())
            elif word == "unplug":
                self.unplug()
            elif word == "plug":
                self.plug()
            elif word == "stop":
                self.unplug()
                self.ended = True
            else:
                return f"error: what is {word}?"
        except ValueError as error:
            return f"error: {error}"
        return "ok"

    def set(self, name, value):
        if name == "privacy":  # the shutter: the value changes, and the status endpoint says so
            self.controls[PRIVACY].now = int(value)
            if self.interrupts:
                self.wire.reply(self.interrupts.popleft(), 0, [bytes([1, PRIVACY[0], 0, PRIVACY[1], 0, int(value)])])
        elif name == "port":  # where it is plugged in the next time
            self.wire.wanted_port = int(value)
        else:
            self.knobs.turn(name, value)
            if name == "pause":
                self.paused_until = time.monotonic() + self.knobs["pause"]

    def stats(self):
        shown = {"%d.%02x" % key: control.now for key, control in self.controls.items()}
        streaming = [str(stream) for stream in self.streams if stream.on]
        return dict(self.counts, plugged=self.wire.socket is not None, port=self.wire.port, opened=len(self.interrupts),
                    streaming=streaming, controls=shown, knobs=self.knobs.turned())

    def serve(self, listener):
        """Runs the camera and answers what its control socket is asked, until it is told to stop."""
        self.selector.register(listener, selectors.EVENT_READ, lambda: self.accept(listener))
        wake = time.monotonic()
        while not self.ended:
            for key, _ in self.selector.select(max(0.0, wake - time.monotonic())):
                if key.fileobj.fileno() >= 0:
                    key.data()
            now = time.monotonic()
            wake = min([now + 1, *(stream.flow(now) for stream in self.streams if stream.on)])

    def accept(self, listener):
        asking, _ = listener.accept()
        with asking:
            asking.settimeout(1)
            try:
                line = asking.recv(65536).decode().strip()
                asking.sendall((self.told(line) + "\n").encode())
            except OSError:
                pass  # who asked is gone
