"""gimbald against emulated webcams behind the kernel's own uvcvideo driver, case by case. In the virtual machine, as root:

    uvc.d PROGRAM [--core] [--only NAME,...] [--size WxH] [--list]

Each case plugs a camera in, runs PROGRAM from it to a loopback that a reader watches, does something to the camera, and says what the
reader saw, what gimbald said and counted, and what the camera sent. PASS: the daemon lives, and what the case asks for holds. The exit
status is 1 where a case failed. The rates that are asked for are those of a machine that is not overloaded.
"""
import argparse
import faulthandler
import json
import os
import subprocess
import sys
import threading

sys.path.insert(1, os.path.dirname(os.path.dirname(os.path.realpath(__file__))))

from cases import CASES
from rig import loopback, now
from bench import Bench, Shared

LONGEST = 300  # seconds that a case may take


def hangs(case):
    """A case that does not end: says where everything stands, and ends the suite (where the suite itself waits in the kernel, the machine's
    time limit does)."""
    print(f"FAIL {case.name}: it hangs", flush=True)
    faulthandler.dump_traceback(sys.stdout)
    # The kernel's log has what has waited in it for two minutes, and for what.
    subprocess.run("dmesg | tail -n 100", shell=True, check=False)
    os._exit(1)


def run(case, shared):
    """Runs one case and tells of it; whether it passed."""
    bench, began = Bench(shared), now()
    watch = threading.Timer(LONGEST, hangs, [case])
    watch.daemon = True
    watch.start()
    try:
        case.run(bench)
    except Exception as error:  # one case does not end the others
        bench.failed.append(f"{type(error).__name__}: {error}")
    if bench.daemon and bench.daemon.alive():
        bench.status()
    sent = bench.end()
    watch.cancel()
    passed = not bench.failed
    print(f"{'PASS' if passed else 'FAIL'} {case.name} ({now() - began:.0f} s)" + (": not so: " + "; ".join(bench.failed) if bench.failed else ""))
    for note in bench.notes:
        print(f"     {note}")
    for name, stats in sent.items():
        shown = {key: value for key, value in stats.items() if key not in ("controls", "plugged", "port", "knobs", "opened")}
        print(f"     {name}: {json.dumps(shown)}")
    kept = ("state", "what", "fps", "frames", "drops", "said")
    print(f"     gimbald: {json.dumps({key: bench.last_status[key] for key in kept if key in bench.last_status})}")
    for line in bench.said().splitlines()[-6 if passed else -40:]:
        print(f"     | {line[:300]}")
    sys.stdout.flush()
    return passed


def main():
    p = argparse.ArgumentParser(prog="uvc", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("program")
    p.add_argument("--core", action="store_true", help="the few that continuous integration runs")
    p.add_argument("--only", default="", help="these cases")
    p.add_argument("--size", default="1280x720", help="what gimbald is told to ask the camera for, where the case says nothing")
    p.add_argument("--pictures", default="", help="a folder with the camera's pictures (see webcam/__main__.py)")
    p.add_argument("--list", action="store_true", help="only names the cases")
    options = p.parse_args()
    wanted = [name for name in options.only.split(",") if name]
    names = [case.name for case in CASES]
    unknown = [name for name in wanted if name not in names]
    if unknown:
        p.error(f"no case {', '.join(unknown)}; there are {', '.join(names)}")
    chosen = [case for case in CASES if (not wanted or case.name in wanted) and (case.core or not options.core)]
    if options.list:
        print("\n".join(case.name for case in chosen))
        return 0
    size = tuple(int(number) for number in options.size.split("x"))
    shared = Shared(os.path.abspath(options.program), loopback(), size, options.pictures)
    failed = [case.name for case in chosen if not run(case, shared)]
    print(f"{len(chosen)} cases, {len(failed)} failed{': ' + ', '.join(failed) if failed else ''}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
