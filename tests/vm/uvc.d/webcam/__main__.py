"""An emulated USB webcam behind the kernel's own uvcvideo driver. In the virtual machine, as root:

    webcam start [--name N] [OPTION...] [KEY=VALUE...]   plug one in, and serve it in the background; says its node
    webcam set [--name N] KEY=VALUE...                   change a fault or what the camera does, while it runs
    webcam stats [--name N]                              what it sent, as JSON
    webcam unplug | plug [--name N]                      pull the plug; put it back in (set port=N: into another port)
    webcam stop [--name N]                               unplug it and end
    webcam pictures [--pictures DIR]                     only make its pictures (anywhere, as anybody)
    webcam knobs                                         every KEY with its meaning

The camera speaks USB/IP to vhci_hcd over a socket pair: no network, no gadget driver, nothing but vhci_hcd, uvcvideo and Python's
standard library. It answers UVC's requests itself and builds every payload itself, so that each of them can be wrong (see `knobs`).

Isochronous (default): high speed, as most webcams are; YUYV is 640x480 at 30, 720p at 10, 1080p at 5. Bulk: SuperSpeed, YUYV at 30
everywhere. H264 is offered (--formats, --second), but what it sends is JPEG. Pictures loop: a folder of one's own (--pictures) with longer clips
serves where what is seen at the cut matters.
"""
import argparse
import json
import os
import socket
import subprocess
import sys

if __package__ in (None, ""):  # run as a folder: python3 uvc.d/webcam
    sys.path[0] = os.path.dirname(sys.path[0])

from webcam import remote
from webcam.device import Camera
from webcam.knobs import KNOBS
from webcam.usbip import VHCI

SIZES = "640x480,1280x720,1920x1080"


def arguments():
    p = argparse.ArgumentParser(prog="webcam", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("verb", choices=["start", "set", "stats", "unplug", "plug", "stop", "pictures", "knobs"])
    p.add_argument("pairs", nargs="*", metavar="KEY=VALUE", help="for start and set")
    p.add_argument("--name", default="cam", help="which camera, where there are several")
    p.add_argument("--card", default="Test Webcam", help="its product name")
    p.add_argument("--serial", default="TEST0001", help="empty: it has none")
    p.add_argument("--vendor", type=lambda text: int(text, 16), default=0x1209)
    p.add_argument("--product", type=lambda text: int(text, 16), default=0x0001)
    p.add_argument("--bulk", action="store_true", help="a bulk endpoint instead of an isochronous one")
    p.add_argument("--speed", choices=["high", "super"], help="USB speed (high; super with --bulk)")
    p.add_argument("--payload", type=int, default=32768, help="bulk: dwMaxPayloadTransferSize")
    p.add_argument("--bandwidth", type=int, default=0, help="say this dwMaxPayloadTransferSize, whatever can be had")
    p.add_argument("--greedy", action="store_true", help="isochronous: always ask for all of the bus, as cheap webcams do")
    p.add_argument("--formats", default="MJPG,YUYV", help="in the order in which the camera lists them: MJPG,YUYV,NV12,GREY,H264")
    p.add_argument("--sizes", default=SIZES)
    p.add_argument("--second", help="a second stream of the same camera: FORMATS[:SIZES]")
    p.add_argument("--second-first", action="store_true", help="the second stream has the lower node")
    p.add_argument("--continuous", action="store_true", help="frame intervals as a range instead of a list")
    p.add_argument("--fps60", action="store_true", help="MJPG also at 60 fps up to 720p")
    p.add_argument("--nocontrols", action="store_true")
    p.add_argument("--pictures", default="/var/tmp/gimbald-webcam", help="folder of WxH.mjpeg and WxH.yuyv (made where missing)")
    p.add_argument("--count", type=int, default=60, help="how many pictures to make")
    p.add_argument("--port", type=int, help="port of vhci_hcd, 0 to 7")
    p.add_argument("--seed", type=int, default=1)
    options = p.parse_intermixed_args()
    options.speed = options.speed or ("super" if options.bulk else "high")
    if options.speed == "super" and not options.bulk:
        p.error("isochronous endpoints are of high speed here")
    return options


def start(options):
    """Plugs a camera in and leaves it running in the background."""
    for module in ("vhci-hcd", "uvcvideo"):
        subprocess.run(["modprobe", module], check=False)
    if not os.path.exists(VHCI + "/attach"):
        raise SystemExit("webcam: no vhci_hcd in this kernel")
    os.makedirs(remote.RUN, exist_ok=True)
    camera = Camera(options)
    if (answer := camera.told("set " + " ".join(options.pairs))) != "ok":
        raise SystemExit(f"webcam: {answer}")
    camera.make_pictures()
    path = remote.socket_of(options.name)
    if os.path.exists(path):
        os.unlink(path)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.bind(path)
    listener.listen(8)
    if os.fork() == 0:
        background(f"{remote.RUN}/{options.name}.log")
        camera.plug()
        camera.serve(listener)
        os._exit(0)
    listener.close()
    port = json.loads(remote.ask(options.name, "stats"))["port"]
    node = remote.node_at(port, options.speed, patience=30)
    if not node:
        raise SystemExit("webcam: no video node came")
    print(node)


def background(log):
    """Detaches this process from whoever started it."""
    os.setsid()
    out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(out, 1)
    os.dup2(out, 2)


def main():
    options = arguments()
    if options.verb == "knobs":
        for name, (default, meaning) in KNOBS.items():
            print(f"{name:15} {meaning} ({default!r})")
    elif options.verb == "start":
        start(options)
    elif options.verb == "pictures":
        Camera(options).make_pictures()
    else:
        print(remote.ask(options.name, " ".join([options.verb, *options.pairs])))


if __name__ == "__main__":
    main()
