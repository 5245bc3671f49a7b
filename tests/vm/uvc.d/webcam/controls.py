"""The camera's controls: brightness and its kin, as values that can be read and set."""
import struct

from .descriptors import CAMERA_TERMINAL, PROCESSING_UNIT

SET_CUR, GET_CUR, GET_MIN, GET_MAX, GET_RES, GET_LEN, GET_INFO, GET_DEF = 0x01, 0x81, 0x82, 0x83, 0x84, 0x85, 0x86, 0x87
PRIVACY = CAMERA_TERMINAL, 0x11
AUTO_PRIORITY = CAMERA_TERMINAL, 0x03  # exposure_dynamic_framerate


class Control:
    """One control: its size in bytes, its range and its value."""

    def __init__(self, size, low, high, step, default, info=3):
        self.size, self.info = size, info
        self.values = {GET_CUR: default, GET_MIN: low, GET_MAX: high, GET_RES: step, GET_DEF: default}

    @property
    def now(self):
        return self.values[GET_CUR]

    @now.setter
    def now(self, value):
        self.values[GET_CUR] = value

    def get(self, request):
        """The answer to a GET request; None where it is no such request."""
        if request == GET_LEN:
            return struct.pack("<H", self.size)
        if request == GET_INFO:
            return bytes([self.info])
        value = self.values.get(request)
        return None if value is None else (value & (1 << 8 * self.size) - 1).to_bytes(self.size, "little")


def pair(value):
    """Two 32-bit values in one control: pan and tilt."""
    return value & 0xFFFFFFFF | (value & 0xFFFFFFFF) << 32


def controls():
    """Every control by (entity, selector)."""
    camera = {
        0x02: Control(1, 1, 8, 0x0D, 8),  # auto exposure mode
        0x03: Control(1, 0, 1, 1, 1),  # auto exposure priority
        0x04: Control(4, 3, 2047, 1, 250),  # exposure time
        0x08: Control(1, 0, 1, 1, 1),  # auto focus
        0x0B: Control(2, 100, 500, 1, 100),  # zoom
        0x0D: Control(8, pair(-36000), pair(36000), pair(3600), 0),  # pan and tilt
        0x11: Control(1, 0, 1, 1, 0, info=0x09),  # privacy shutter
    }
    processing = {
        0x01: Control(2, 0, 3, 1, 1),  # backlight compensation
        0x02: Control(2, -64, 64, 1, 0),  # brightness
        0x03: Control(2, 0, 95, 1, 32),  # contrast
        0x04: Control(2, 0, 100, 1, 20),  # gain
        0x05: Control(1, 0, 2, 1, 1),  # power line frequency
        0x07: Control(2, 0, 100, 1, 55),  # saturation
        0x08: Control(2, 0, 7, 1, 2),  # sharpness
        0x0A: Control(2, 2800, 6500, 10, 4600),  # white balance temperature
        0x0B: Control(1, 0, 1, 1, 1),  # auto white balance
    }
    found = {(CAMERA_TERMINAL, selector): control for selector, control in camera.items()}
    found.update({(PROCESSING_UNIT, selector): control for selector, control in processing.items()})
    return found
