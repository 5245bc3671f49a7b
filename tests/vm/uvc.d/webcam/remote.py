"""Talking to a camera that runs, and finding its nodes."""
import os
import socket
import time

RUN = "/run/gimbald-webcam"
TOP = "/sys/class/video4linux"


def socket_of(name):
    return f"{RUN}/{name}.sock"


def ask(name, line):
    """What the camera of that name answers. SystemExit where it refuses, or where there is none."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as to:
        try:
            to.connect(socket_of(name))
        except OSError:
            raise SystemExit(f"webcam: no camera of the name {name} runs") from None
        to.settimeout(20)
        to.sendall((line + "\n").encode())
        answer = b""
        while not answer.endswith(b"\n") and (data := to.recv(65536)):
            answer += data
    answer = answer.decode().strip()
    if answer.startswith("error"):
        raise SystemExit(f"webcam: {answer}")
    return answer


def nodes_at(port, speed):
    """The video nodes of the camera at a port of vhci_hcd, in the order of their numbers."""
    found = []
    names = os.listdir(TOP) if os.path.isdir(TOP) else []
    for name in sorted(names, key=lambda name: (len(name), name)):
        path = os.path.realpath(f"{TOP}/{name}/device")
        if "vhci_hcd" not in path:
            continue
        # .../usb2/2-3/2-3:1.0: the third port of the bus is port 2 of the controller
        bus, _, place = os.path.basename(os.path.dirname(path)).partition("-")
        with open(f"/sys/bus/usb/devices/usb{bus}/speed") as file:
            fast = int(file.read()) > 480
        if place == str(port % 8 + 1) and fast == (speed == "super") and os.path.exists("/dev/" + name):
            found.append("/dev/" + name)
    return found


def node_at(port, speed, patience):
    """The first node of the camera at a port, as soon as it is there; None where patience (seconds) runs out."""
    end = time.monotonic() + patience
    while True:
        if found := nodes_at(port, speed):
            return found[0]
        if time.monotonic() > end:
            return None
        time.sleep(0.05)
