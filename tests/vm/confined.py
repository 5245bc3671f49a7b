"""The daemon as the shipped unit confines it: for the scripts that start it themselves.

With GIMBALD_UNIT, the path of a unit file, rig.Daemon starts the program as a service with all that this file says but what to run and
when to run it again: the scripts stop, kill and start it as they do without.
"""
import os
import shutil
import signal
import subprocess
import time

# Of the unit: what says how it is begun, ended and watched. The rest says what it may do.
LEFT_OUT = ("ExecStart=", "ExecReload=", "Type=", "NotifyAccess=", "Timeout", "WatchdogSec=", "Restart", "RuntimeDirectory=", "PrivateTmp=",
            "StateDirectory=", "SystemCallErrorNumber=")
PROGRAM = "/usr/bin/gimbald"


class Service:
    """What subprocess.Popen is to a process, to a service."""

    count = 0

    def __init__(self, arguments, log, env, unit):
        Service.count += 1
        self.name = f"gimbald-confined-{Service.count}.service"
        if not os.path.exists(PROGRAM) or not os.path.samefile(arguments[0], PROGRAM):
            # Where the unit's ExecPaths= has it; homes and other folders are hidden.
            shutil.copy(arguments[0], PROGRAM + ".new")
            os.rename(PROGRAM + ".new", PROGRAM)
        with open(unit) as file:
            section = file.read().split("[Service]\n")[1].split("\n[")[0].splitlines()
        lines = [line for line in section if line and not line.startswith(("#", *LEFT_OUT))]
        words = " ".join('"' + word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%") + '"' for word in [PROGRAM, *arguments[1:]])
        runtime = "gimbald" if Service.count == 1 else f"gimbald-{Service.count}"
        lines += [f"ExecStart={words}", "Type=exec", f"StandardOutput=append:{log}", f"StandardError=append:{log}",
                  f"RuntimeDirectory={runtime}"]
        # No SystemCallErrorNumber=: a call that is not on the list kills it.
        lines += [f'Environment="{name}={value}"' for name, value in env.items()]
        with open(f"/run/systemd/system/{self.name}", "w") as file:
            file.write("[Service]\n" + "\n".join(lines) + "\n")
        self._systemctl("daemon-reload")
        self._systemctl("start", self.name)
        self.pid = int(self._property("MainPID"))

    @staticmethod
    def _systemctl(*words):
        done = subprocess.run(["systemctl", *words], capture_output=True, text=True)
        if done.returncode:
            print("systemctl", *words, done.stderr.strip(), flush=True)
        return done.stdout.strip()

    def _property(self, name):
        return self._systemctl("show", "-P", name, self.name)

    def poll(self):
        """None while it runs; then its exit code, or the signal that ended it, negative."""
        if self._property("ActiveState") not in ("inactive", "failed"):
            return None
        status = int(self._property("ExecMainStatus"))
        return status if self._property("ExecMainCode") == "1" else -status

    def send_signal(self, number):
        try:
            os.kill(self.pid, number)
        except ProcessLookupError:
            pass

    def kill(self):
        self.send_signal(signal.SIGKILL)

    def wait(self, patience=None):
        end = time.monotonic() + (3600 if patience is None else patience)
        while (code := self.poll()) is None:
            if time.monotonic() > end:
                raise subprocess.TimeoutExpired(self.name, patience)
            time.sleep(0.05)
        return code
