"""The PipeWire camera with a real camera driver and a real service: without v4l2loopback, beside it, and for whom it is.

In the virtual machine, without the loopback: GIMBALD_VM="tests/vm/machine --loopback off" tests/vm/guest pipewire [PART...]
Parts: alone users rules (all). Arguments: the program, parts.
"""
import json
import os
import re
import shutil
import subprocess
import sys
import time

from desktop import Session, Watcher, skip_if_lacking
from rig import Camera, Daemon, Reader, Report, camera_appears, loopback, now, until

WIDTH, HEIGHT = FULL = (640, 480)
SIZE = [f"camera.width={WIDTH}", f"camera.height={HEIGHT}", "camera.fps=30"]
PROGRAM = sys.argv[1]
report = Report()
skip_if_lacking()


def alone():
    """Without v4l2loopback."""
    session = Session("root", PROGRAM)
    session.companion()
    daemon = Daemon(PROGRAM, "auto", *SIZE, "output.linger_s=1", env={"XDG_RUNTIME_DIR": session.place}).start()
    report.check("without a loopback the node has the camera's size", until(15, lambda: session.size() == {"width": WIDTH, "height": HEIGHT}))
    time.sleep(1)
    report.check("and the camera is closed", not Camera.is_open())
    environment = {**session.environment(), "XDG_RUNTIME_DIR": session.place}
    doctor = subprocess.run([PROGRAM, "doctor"], env=environment, capture_output=True, text=True).stdout
    report.say(doctor)
    report.check("doctor says that the picture goes to PipeWire", "PipeWire is the only output" in doctor and "the camera gimbald is available" in doctor)
    report.check("      and has no fault for the loopback", not re.search("FAULT +(module|output|pipewire)", doctor))
    report.check("the camera itself gives its frames evenly", Camera.becomes_even((WIDTH, HEIGHT), 30))
    own = []
    for _ in range(3):
        with Reader(Camera.path(), size=(WIDTH, HEIGHT), fps=30) as reader:
            own.append(reader.frame(5).came - reader.started)
    report.say("      the camera's own first frame comes after", *(f"{seconds:.3f}" for seconds in own), "s")
    for _ in range(5):
        subprocess.run(session.words("wpctl", "status"), env=session.environment(), capture_output=True)
        session.dump()
    report.check("listing leaves it closed", not Camera.is_open())
    # The first program of GStreamer's in a session looks through all plugins; those after it need not.
    session.start("gst-inspect-1.0", "pipewiresrc").wait()
    added = []
    for visit in range(3):
        with Watcher(session, FULL) as first:
            came = first.live()
            report.check(f"visit {visit}: live pictures come", came)
            report.check("      the camera is open", Camera.is_open())
            with Watcher(session, FULL) as second:
                at_once = second.live()
                report.check("      for a second program as well", at_once)
            if came and at_once:
                # What the second needed is the program's own start: the camera was open.
                took, program = came - first.started, at_once - second.started
                added.append(took - program - max(own))
                report.say(f"      {took:.3f} s after the program was started; the second's after {program:.3f} s")
            report.check("      the first goes on when the second has left", first.live() and Camera.is_open())
        left = now()
        report.check("      the camera is closed when nobody watches", until(5, lambda: not Camera.is_open()))
        report.say(f"      {now() - left:.2f} s after the program left")
    report.check(f"live at most 0.3 s after the camera's own start: {max(added, default=9):.3f} s at worst", max(added, default=9) <= 0.3)

    with Watcher(session, FULL) as watcher:
        report.check("a program watches", watcher.live())
        daemon.kill()
        at = len(watcher.frames)
        report.check("the daemon is killed: the last picture goes on", until(5, lambda: len(watcher.frames) >= at + 8))
        report.check("      and it is one of the camera's", all(live for _, live, _ in watcher.frames[at + 2:]))
        daemon.start()
        begun = now()
        report.check("      and live ones when it is back", watcher.live(15))
        report.say(f"      {now() - begun:.2f} s after the start")
        daemon.kill()
        daemon.sets = [word.replace(str(WIDTH), "1280").replace(str(HEIGHT), "720") for word in daemon.sets]
        daemon.start()
        report.check("the camera has another size: the program keeps its own and goes on", watcher.live(15))
        report.check("      and its node too", session.size() == {"width": WIDTH, "height": HEIGHT})
    report.check("when it has left, the node has the new size", until(10, lambda: session.size() == {"width": 1280, "height": 720}))
    with Watcher(session, (1280, 720)) as watcher:
        report.check("      which a new program gets", watcher.live())
    daemon.kill()
    daemon.sets = [word.replace("1280", str(WIDTH)).replace("720", str(HEIGHT)) for word in daemon.sets]
    daemon.start()
    report.check("and the old size comes back", until(10, lambda: session.size() == {"width": WIDTH, "height": HEIGHT}))

    with Watcher(session, FULL) as watcher:
        report.check("a program watches", watcher.live())
        Camera.unplug()
        report.check("unplugged: the dark picture comes", until(10, lambda: watcher.frames and not watcher.frames[-1][1]))
        Camera.plug()
        report.check("plugged in again: live pictures", watcher.live(20))
    until(5, lambda: not Camera.is_open())

    subprocess.run(["modprobe", "v4l2loopback", "video_nr=10", "exclusive_caps=1", "max_buffers=8", "card_label=gimbald"], check=True)
    out = loopback()
    report.check("v4l2loopback is loaded later: it becomes a camera too", camera_appears(out, 20))
    with Watcher(session, FULL) as watcher, Reader(out) as reader:
        report.check("both at once: PipeWire", watcher.live())
        report.check("      and the loopback", reader.live(5))
    report.check("      and the camera is closed then", until(6, lambda: not Camera.is_open()))
    with Reader(out) as reader:
        report.check("the loopback alone", reader.live(5))
        report.check("      opens no node", session.node()["state"] != "running")
    report.check("the daemon stops", daemon.stop() == 0)
    if report.failed:
        print(daemon.said(), session.said())
    session.end()
    subprocess.run(["modprobe", "-r", "v4l2loopback"])


class Seat:
    """Sessions at the machine's seat, as a login screen makes them: logind gives the active one's user the camera."""

    def __init__(self):
        import dbus
        self.dbus, self.kept, login = dbus, [], dbus.SystemBus().get_object("org.freedesktop.login1", "/org/freedesktop/login1")
        self.manager = dbus.Interface(login, "org.freedesktop.login1.Manager")

    def enter(self, uid):
        number, leader = self.dbus.UInt32, subprocess.Popen(["sleep", "infinity"])
        session = self.manager.CreateSession(
            number(uid), number(leader.pid), "test", "wayland", "user", "", "seat0", number(0), "", "", False, "", "",
            self.dbus.Array([], signature="(sv)"), timeout=120)
        self.kept.append((leader, session[3].take()))
        return str(session[0])

    def activate(self, session):
        self.manager.ActivateSession(session)

    def leave(self):
        for leader, descriptor in self.kept:
            leader.kill()
            leader.wait()
            os.close(descriptor)


def service(*sets):
    """The service as it ships, but for where the program is and what it is set to; what its list of system calls lacks ends it."""
    shutil.copy(PROGRAM, "/usr/bin/gimbald")
    unit = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../systemd/gimbald.service")
    shutil.copy(unit, "/run/systemd/system/gimbald.service")
    os.makedirs("/run/systemd/system/gimbald.service.d", exist_ok=True)
    words = " ".join(f"--set {word}" for word in sets)
    with open("/run/systemd/system/gimbald.service.d/test.conf", "w") as file:
        file.write(f"[Service]\nExecStart=\nExecStart=/usr/bin/gimbald run {words}\nSystemCallErrorNumber=\n")
    subprocess.run(["systemctl", "daemon-reload"], check=True)
    return subprocess.run(["systemctl", "start", "gimbald"]).returncode == 0


def account(name, *groups):
    subprocess.run(["useradd", "-M", name], check=True)
    return int(subprocess.run(["id", "-u", name], capture_output=True, text=True, check=True).stdout), ",".join(groups)


def pipewire_now():
    said = subprocess.run([PROGRAM, "status", "--json"], capture_output=True, text=True).stdout
    return (json.loads(said) if said else {}).get("pipewire") or {}


def users():
    """The real service, and three users: one in the group video, one at the machine's seat, one who was there or will be."""
    path = Camera.path()
    report.check("the service starts", service(*SIZE, "camera.device=vivid", "output.linger_s=1"))
    accounts = {"member": account("member", str(os.stat(path).st_gid)), "first": account("first"), "second": account("second")}
    seat = Seat()
    at_seat = {name: seat.enter(accounts[name][0]) for name in ("first", "second")}
    seat.activate(at_seat["first"])
    sessions = {name: Session(name, PROGRAM, user) for name, user in accounts.items()}
    for name, session in sessions.items():
        session.companion()
        report.check(f"the node of {name} is there", until(15, lambda s=session: s.size() == {"width": WIDTH, "height": HEIGHT}))
    report.check(f"three companions: {pipewire_now()}", until(5, lambda: pipewire_now().get("companions") == 3))
    report.check("no program watches: the camera is closed", not Camera.is_open())

    def sees_nothing(watcher):
        return until(10, lambda: len(watcher.frames) > 8) and not any(live for _, live, _ in watcher.frames)

    with Watcher(sessions["second"], FULL) as absent:
        report.check("a user who may not open the camera sees dark pictures", sees_nothing(absent))
        report.check("      and does not open the camera", not Camera.is_open())
        report.check("      and is told why", f"may not open {path}" in sessions["second"].said())
        with Watcher(sessions["member"], FULL) as member, Watcher(sessions["first"], FULL) as first:
            report.check("a user in the group sees live ones", member.live())
            report.check("      and the one at the seat, at once", first.live() and member.live())
            time.sleep(1)
            report.check("      the other still does not", not any(live for _, live, _ in absent.frames))
            report.check(f"      two cameras are watched: {pipewire_now()}", pipewire_now().get("watched") == 2)
            subprocess.run(["systemctl", "restart", "gimbald"], check=True)
            report.check("      also after a restart of the service", member.live(15) and first.live(15))
            subprocess.run(["systemctl", "kill", "-s", "KILL", "gimbald"])
            report.check("      and after it was killed", member.live(15) and first.live(15))
        report.check("      and the camera is closed then", until(6, lambda: not Camera.is_open()))
    seat.activate(at_seat["second"])
    time.sleep(1)
    with Watcher(sessions["first"], FULL) as first, Watcher(sessions["second"], FULL) as second:
        report.check("another user comes to the seat and sees live pictures", second.live())
        report.check("      the one who was there does not", sees_nothing(first))
    seat.activate(at_seat["first"])
    time.sleep(1)
    with Watcher(sessions["first"], FULL) as first, Watcher(sessions["second"], FULL) as second:
        report.check("and back", first.live() and sees_nothing(second))
    report.check("the camera is closed", until(6, lambda: not Camera.is_open()))
    pid = subprocess.run(["systemctl", "show", "-P", "MainPID", "gimbald"], capture_output=True, text=True).stdout.strip()
    report.check("the service is not root", os.stat(f"/proc/{pid}").st_uid != 0)
    subprocess.run(["systemctl", "stop", "gimbald"])
    journal = subprocess.run(["journalctl", "-b", "-o", "cat", "--no-pager"], capture_output=True, text=True).stdout
    report.check("no system call was missing from the list", "status=31/SYS" not in journal)
    if report.failed:
        print(journal[-8000:])
        print(*(session.said() for session in sessions.values()))
    for session in sessions.values():
        session.end()
    seat.leave()


def rules():
    """The rules that ship as examples hide the real camera and the loopback."""
    # The service may have loaded it otherwise.
    subprocess.run(["modprobe", "-r", "v4l2loopback"])
    subprocess.run(["modprobe", "v4l2loopback", "video_nr=10", "exclusive_caps=1", "max_buffers=8", "card_label=gimbald"], check=True)
    out, camera = loopback(), Camera.path()
    session = Session("rules", PROGRAM)
    session.companion()
    daemon = Daemon(PROGRAM, out, *SIZE, env={"XDG_RUNTIME_DIR": session.place}).start()
    report.check("the loopback becomes a camera", camera_appears(out))
    session.restart_wireplumber()
    listed = lambda: sorted(info["props"].get("api.v4l2.path", "gimbald's own") for info in session.cameras())
    three = until(15, lambda: listed() == sorted([out, camera, "gimbald's own"]))
    report.check(f"without the rules programs list three cameras: {listed()}", three)
    devices = [(thing.get("info") or {}).get("props", {}) for thing in session.dump() if thing.get("type", "").endswith("Device")]
    name = next((props["device.name"] for props in devices if props.get("api.v4l2.path") == camera), "")
    version = subprocess.run(["wireplumber", "--version"], capture_output=True, text=True).stdout
    old = "libwireplumber 0.4" in version
    example = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../systemd/packaging/wireplumber", "60-gimbald." + ("lua" if old else "conf"))
    with open(example) as file:
        text = file.read()
    # As the file says: the marks are taken from its second rule, which gets the camera's name.
    text = re.sub(r"^--(?=table|  |\})" if old else r"^  #(?=\{|\}|  )", "" if old else "  ", text, flags=re.MULTILINE)
    text = re.sub(r"v4l2_device\.pci-[^\"]*", name, text)
    place = f"{session.place}/config/wireplumber/" + ("main.lua.d" if old else "wireplumber.conf.d")
    os.makedirs(place)
    with open(f"{place}/{os.path.basename(example)}", "w") as file:
        file.write(text)
    session.restart_wireplumber()
    one = until(15, lambda: listed() == ["gimbald's own"])
    report.check(f"{version.split()[-1]}, with {os.path.basename(example)} for {name}: only gimbald's own is left: {listed()}", one)
    time.sleep(3)
    report.check("      and stays alone", listed() == ["gimbald's own"])
    status = subprocess.run(session.words("wpctl", "status"), env=session.environment(), capture_output=True, text=True).stdout
    sources = re.split("[├└]─", status.partition("\nVideo")[2].partition("Sources:")[2])[0]
    sources = [line.strip(" │*") for line in sources.splitlines() if line.strip(" │*")]
    report.check(f"      also for wpctl: {sources}", len(sources) == 1 and "gimbald" in sources[0])
    with Watcher(session, FULL) as watcher:
        report.check("      which gives pictures", watcher.live())
    daemon.stop()
    if report.failed:
        print(text, session.said())
    session.end()
    subprocess.run(["modprobe", "-r", "v4l2loopback"])


PARTS = {"alone": alone, "users": users, "rules": rules}
Camera.move()
for part in sys.argv[2:] or PARTS:
    report.say(part)
    PARTS[part]()
report.end()
