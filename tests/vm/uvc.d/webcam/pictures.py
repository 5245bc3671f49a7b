"""The camera's pictures: files of a folder, made with ffmpeg where they are missing."""
import mmap
import os
import subprocess
import sys
import threading

from . import jpeg
from .descriptors import COMPRESSED, frame_bytes


class Pictures:
    """Frames of every size, read when they are first wanted: `WxH.mjpeg` and `WxH.yuyv` (YUYV frames one after the other)."""

    def __init__(self, folder, count, rate=30):
        self.folder, self.count, self.rate = folder, count, rate
        self.held, self.coming, self.lock = {}, set(), threading.Lock()

    def make(self, path, width, height, raw):
        """A textured picture under shake; JPEGs in 4:2:2, as most webcams give it."""
        os.makedirs(self.folder, exist_ok=True)
        margin = max(16, width // 20) & ~1
        source = f"testsrc2=size={width + 2 * margin}x{height + 2 * margin}:rate={self.rate}"
        half = margin // 2
        shake = f"crop={width}:{height}:x='{margin}+{half}*sin(n*1.3)':y='{margin}+{half}*cos(n*0.9)'"
        if raw:
            end = ["-pix_fmt", "yuyv422", "-f", "rawvideo"]
        else:
            end = ["-pix_fmt", "yuvj422p", "-c:v", "mjpeg", "-huffman", "default", "-q:v", "5", "-f", "mjpeg"]
        count = max(4, self.count // 4) if raw else self.count  # raw ones are large
        new = f"{path}.{os.getpid()}"
        subprocess.run(["ffmpeg", "-v", "error", "-nostdin", "-y", "-f", "lavfi", "-i", source, "-vf", shake,
                        "-frames:v", str(count), *end, new], check=True, stdout=sys.stderr)
        os.rename(new, path)

    def soon(self, name, width, height):
        """The frames; None as long as they are still being made: requests have to be answered meanwhile."""
        key = name, width, height
        if key in self.held:
            return self.held[key]
        with self.lock:
            if key not in self.coming:
                self.coming.add(key)
                threading.Thread(target=self.frames, args=key, daemon=True).start()
        return None

    def frames(self, name, width, height):
        """The frames, made now where they are missing."""
        key = name, width, height
        if key not in self.held:
            raw = name not in COMPRESSED
            path = f"{self.folder}/{width}x{height}.{'yuyv' if raw else 'mjpeg'}"
            if not os.path.exists(path):
                self.make(path, width, height, raw)
            with open(path, "rb") as file:
                data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            self.held[key] = self.cut(name, width, height, data) if raw else jpeg.split(data[:])
        return self.held[key]

    @staticmethod
    def cut(name, width, height, data):
        """The raw frames of a file of YUYV ones, in another format where that is wanted."""
        size = frame_bytes("YUYV", width, height)
        frames = [memoryview(data)[at:at + size] for at in range(0, len(data) - size + 1, size)]
        if name == "YUYV":
            return frames
        luma = [bytes(frame[0::2]) for frame in frames]
        if name == "GREY":
            return luma
        # NV12: every second row's chroma, which lies in YUYV as it does there.
        chroma = [bytes(frame[1::2]) for frame in frames]
        rows = range(0, width * height, 2 * width)
        return [grey + b"".join(colour[at:at + width] for at in rows) for grey, colour in zip(luma, chroma)]
