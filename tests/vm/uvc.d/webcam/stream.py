"""A video stream of the camera: what was agreed, and how its frames go out on the bus."""
import collections
import struct
import time

from . import damage
from .controls import AUTO_PRIORITY
from .descriptors import ALTERNATES, RAW, TEN_MILLION, frame_bytes, packet_bytes
from .usbip import EPROTO

PROBE_BYTES = 34
MICROFRAME = 0.000125
NO_MODE = bytes(PROBE_BYTES)


class Stream:
    """One VideoStreaming interface, number `n` from 0."""

    def __init__(self, n, modes, camera):
        self.n, self.modes, self.camera = n, modes, camera
        self.urbs, self.payloads = collections.deque(), collections.deque()
        self.rest = []
        self.frames = None
        self.reset()

    def reset(self):
        """As after plugging in."""
        self.urbs.clear(), self.payloads.clear()
        self.on, self.alternate = False, 0
        self.probe = self.commit = self.answer(NO_MODE)

    # -- agreeing

    def answer(self, asked):
        """A probe block as the camera would have it."""
        knobs, options = self.camera.knobs, self.camera.options
        block = bytearray(asked[:PROBE_BYTES].ljust(PROBE_BYTES, b"\0"))
        format_, frame = block[2], block[3]
        if knobs["probe_fixed"]:
            format_, frame = (int(number) for number in knobs["probe_fixed"].split(":"))
        if not 1 <= format_ <= len(self.modes.formats):
            format_ = 1
        name, frames = self.modes.formats[format_ - 1]
        if not 1 <= frame <= len(frames):
            frame = 1
        width, height, intervals = frames[frame - 1]
        wanted = struct.unpack_from("<I", block, 4)[0]
        if options.continuous and min(intervals) <= wanted <= max(intervals):
            interval = wanted
        else:
            interval = min(intervals, key=lambda one: abs(one - wanted)) if wanted else intervals[0]
        size = frame_bytes(name, width, height)
        block[2], block[3] = format_, frame
        struct.pack_into("<I", block, 4, interval)
        struct.pack_into("<I", block, 18, knobs["maxframe"] or size)
        payload = options.bandwidth or self.payload_bytes(name, width * height, size, interval)
        struct.pack_into("<IIBBBB", block, 22, payload, damage.CLOCK, 3, 1, 1, 1)
        return bytes(block)

    def payload_bytes(self, name, pixels, size, interval):
        """dwMaxPayloadTransferSize: what a microframe has to carry."""
        options = self.camera.options
        if options.bulk:
            return options.payload
        rate = 1.1 * size * TEN_MILLION / interval if name in RAW else pixels * 30 / 3
        needed = packet_bytes(ALTERNATES[-1]) if options.greedy else rate * MICROFRAME + 12
        return next((packet_bytes(one) for one in ALTERNATES if packet_bytes(one) >= needed), packet_bytes(ALTERNATES[-1]))

    # -- starting and stopping

    def start(self):
        now, knobs = time.monotonic(), self.camera.knobs
        name, frames = self.modes.formats[self.commit[2] - 1]
        width, height, _ = frames[self.commit[3] - 1]
        self.on, self.frame_id, self.number = True, 0, 0
        self.format, self.size = name, (width, height)
        self.frames = self.camera.pictures.soon(name, width, height)
        self.interval = struct.unpack_from("<I", self.commit, 4)[0] / TEN_MILLION
        bulk = self.camera.options.bulk
        self.payload = struct.unpack_from("<I", self.commit, 22)[0] if bulk else packet_bytes(ALTERNATES[self.alternate - 1])
        self.bus, self.due = now, now + knobs["late"]
        self.payloads.clear()
        self.rest = []
        if knobs["hang"] == 1:
            knobs["hang"] = 0
        self.camera.counts["starts"] += 1

    def stop(self):
        if not self.on:
            return
        self.on = False
        self.payloads.clear()
        while self.urbs:
            self.camera.wire.reply(self.urbs.popleft(), 0)

    def __str__(self):
        width, height = self.size
        return f"{self.format} {width}x{height} every {self.interval:.4f} s, {self.payload} bytes a payload"

    # -- frames

    def expose(self, now):
        """Puts up the next frame's payloads, if it is time."""
        camera, knobs = self.camera, self.camera.knobs
        if now < self.due or self.payloads or self.rest or knobs["hang"]:
            return
        if now < camera.paused_until:
            self.due = camera.paused_until
            return
        if self.frames is None:
            self.frames = camera.pictures.soon(self.format, *self.size)
            if self.frames is None:
                self.due = now + 0.05
                return
        step = self.interval * knobs["slow"]
        if knobs["dark"] and camera.controls[AUTO_PRIORITY].now:
            step *= 2
        if knobs["skip"] and now - self.due > step:
            missed = int((now - self.due) / step)
            self.due += missed * step
            self.number += missed
            camera.counts["skipped"] += missed
        frame = damage.picture(self, knobs, camera.chance, camera.pictures, camera.counts)
        self.payloads.extend(damage.payloads(self, frame, now, knobs, camera.chance, camera.counts))
        self.number += 1
        camera.counts["frames"] += 1
        self.due += step
        if now - self.due > 1:
            self.due = now

    def flow(self, now):
        """Answers the requests that can be answered; gives the time when there is more to do."""
        return self.flow_bulk(now) if self.camera.options.bulk else self.flow_isochronous(now)

    def glitch(self, urb):
        """Whether the bus spoils this transfer."""
        if self.camera.knobs["urb_error"] <= 0:
            return False
        self.camera.knobs["urb_error"] -= 1
        self.camera.counts["urb_errors"] += 1
        self.camera.wire.reply(urb, -EPROTO)
        return True

    def flow_bulk(self, now):
        """As fast as the host asks. A payload ends with a short transfer, or by having the agreed length."""
        while self.urbs and self.camera.wire.socket:
            self.expose(now)
            if not self.rest:
                if not self.payloads:
                    break
                header, data, _ = self.payloads.popleft()
                self.rest, self.sent = [header, data], 0
            urb = self.urbs.popleft()
            if self.glitch(urb):
                continue
            parts, room = [], urb.length
            while room and self.rest:
                parts.append(self.rest[0][:room])
                self.rest[0] = self.rest[0][room:]
                room -= len(parts[-1])
                if not self.rest[0]:
                    self.rest.pop(0)
            self.sent += urb.length - room
            if not self.rest and not room and self.sent < self.payload:
                self.rest = [b""]  # it ended with a full transfer: an empty one has to say so
            self.camera.wire.reply(urb, 0, [part for part in parts if part])
        if self.camera.knobs["hang"] or not self.urbs:
            return now + 0.5
        return max(self.due, self.camera.paused_until)

    def flow_isochronous(self, now):
        """The bus has a time of its own: a packet in each microframe, filled or not."""
        while self.urbs and self.camera.wire.socket:
            end = self.bus + self.urbs[0].npackets * MICROFRAME
            if now < end:
                return end
            self.bus = now if now - end > 0.5 else end
            urb = self.urbs.popleft()
            if self.glitch(urb):
                continue
            parts, packets = [], []
            for _ in range(urb.npackets):
                if not self.payloads:
                    self.expose(now)
                if not self.payloads:
                    packets.append((0, 0))
                    continue
                header, data, status = self.payloads.popleft()
                # of a damaged packet the header comes through
                parts += [header] if status else [header, data]
                packets.append((len(header) + (0 if status else len(data)), status))
            self.camera.wire.reply(urb, 0, parts, packets=packets)
        return now + 1
