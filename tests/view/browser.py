"""Chromium shows the pages of `gimbald view` and a report; driven over its DevTools protocol through a pipe, with Python's standard library.

    python3 tests/view/browser.py CHROMIUM DAEMON-PAGE-ADDRESS RECORDING-PAGE-ADDRESS REPORT-FILE SERVICE-REPORT-FILE [FOLDER-FOR-PICTURES]
"""
import base64
import fcntl
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time

PATIENCE = 120
failed = 0


def check(what, holds):
    global failed
    failed += not holds
    print("ok  " if holds else "FAIL", what, flush=True)
    return holds


class Browser:
    """DevTools over two pipes: messages end with a zero byte."""

    def __init__(self, program):
        self.profile = tempfile.mkdtemp(prefix="gimbald-chromium-")
        self.said = tempfile.TemporaryFile()
        ours_out, theirs_in = os.pipe()
        theirs_out, ours_in = os.pipe()

        # The protocol's descriptors are 3 and 4, whatever ours are: first out of the way of both.
        def arrange():
            spare = [fcntl.fcntl(fd, fcntl.F_DUPFD, 64) for fd in (theirs_out, theirs_in)]
            for fd, place in zip(spare, (3, 4)):
                os.dup2(fd, place, inheritable=True)

        self.process = subprocess.Popen(
            [program, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
             "--disable-component-update", "--disable-sync", "--disable-extensions", "--disable-dev-shm-usage", "--disable-backgrounding-occluded-windows",
             f"--user-data-dir={self.profile}", "--remote-debugging-pipe", "about:blank"],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=self.said, preexec_fn=arrange, close_fds=False)
        os.close(theirs_in)
        os.close(theirs_out)
        self.read_end, self.write_end, self.rest, self.count = ours_out, ours_in, b"", 0
        self.log = []

    def send(self, method, session=None, **params):
        """The answer to one message."""
        self.count += 1
        message = {"id": self.count, "method": method, "params": params}
        if session:
            message["sessionId"] = session
        os.write(self.write_end, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            for heard in self.hear(end):
                if heard.get("id") == self.count:
                    if "error" in heard:
                        raise RuntimeError(f"{method}: {heard['error']}")
                    return heard["result"]
                if heard.get("method") in ("Runtime.exceptionThrown", "Log.entryAdded"):
                    self.log.append(heard["params"])
        raise TimeoutError(method)

    def hear(self, end):
        if select.select([self.read_end], [], [], max(0, end - time.monotonic()))[0]:
            heard = os.read(self.read_end, 1 << 20)
            if not heard:
                self.said.seek(0)
                raise EOFError("the browser has ended; it said: " + self.said.read().decode(errors="replace")[-3000:])
            self.rest += heard
        *whole, self.rest = self.rest.split(b"\0")
        return [json.loads(text) for text in whole]

    def close(self):
        self.process.kill()
        self.process.wait()
        shutil.rmtree(self.profile, ignore_errors=True)


class Tab:
    def __init__(self, browser, address, width=1280, height=900):
        self.browser = browser
        # A window of its own: a page in a hidden tab requests no pictures.
        target = browser.send("Target.createTarget", url="about:blank", newWindow=True)["targetId"]
        self.session = browser.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.send(f"{domain}.enable")
        self.size(width, height)
        self.send("Page.navigate", url=address)

    def send(self, method, **params):
        return self.browser.send(method, self.session, **params)

    def size(self, width, height):
        self.send("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600)

    def ask(self, script):
        answer = self.send("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{script}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def until(self, script):
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            try:
                if value := self.ask(script):
                    return value
            except RuntimeError:
                pass
            time.sleep(0.1)
        return None

    def scheme(self, scheme):
        self.send("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def key(self, key, code=None):
        for kind in ("keyDown", "keyUp"):
            self.send("Input.dispatchKeyEvent", type=kind, key=key, code=code or key, text=key if len(key) == 1 else "")

    def picture(self, folder, name):
        if folder:
            data = self.send("Page.captureScreenshot", format="png", captureBeyondViewport=True)["data"]
            with open(f"{folder}/{name}.png", "wb") as file:
                file.write(base64.b64decode(data))


# A number for the samples in a part of the canvas (left, top, width, height; shares), so that two pictures can be told apart.
SUM = """(() => { const c = document.getElementById('picture'), d = c.getContext('2d').getImageData(%s * c.width, %s * c.height,
 %s * c.width, %s * c.height).data; let s = 0; for (let i = 0; i < d.length; i += 4) s = (s * 31 + d[i] + 3 * d[i + 1]) %% 1000003; return s; })()"""
LEFT, RIGHT, ALL = SUM % (0, 0, 0.2, 1), SUM % (0.8, 0, 0.2, 1), SUM % (0, 0, 1, 1)
PICTURES = "Number(document.body.dataset.pictures || 0)"
STATE = "fetch(location.pathname + 'state').then(answer => answer.json()).then(answer => %s)"


def text(name):
    return f"document.getElementById('{name}').textContent"


def slide(tab, name, value):
    """Moves a slider: the value, then the event."""
    tab.ask(f"""(() => {{ const s = document.getElementById({json.dumps('set-' + name)}); s.value = {value};
        s.dispatchEvent(new Event('input', {{bubbles: true}})); }})()""")


def drag(tab, share):
    """Drags the divider with the mouse to a share of the picture's width."""
    box = tab.ask("(() => { const b = document.getElementById('stage').getBoundingClientRect(); return [b.x, b.y, b.width, b.height]; })()")
    y = box[1] + box[3] / 2
    for kind, x, buttons in (("mousePressed", 0.5, 1), ("mouseMoved", share, 1), ("mouseReleased", share, 0)):
        tab.send("Input.dispatchMouseEvent", type=kind, x=box[0] + x * box[2], y=y, button="left", buttons=buttons, clickCount=1)


def daemon(browser, address, folder):
    tab = Tab(browser, address)
    if not check("the daemon's page shows pictures", tab.until(PICTURES + " > 2")):
        return
    sums = {tab.ask(ALL) for _ in range(12) if time.sleep(0.15) is None}
    check("the picture moves", len(sums) > 3)
    check("trust, latency, losses and viewers are shown", tab.until(
        "['trust', 'latency', 'frames lost', 'viewers', 'frame rate'].every(name => " + text("facts") + ".includes(name))"))
    check("it says that the page counts as a viewer", "counts as a viewer" in tab.ask(text("note")))
    check("the path fills up", tab.until("series.length > 60 && series[series.length - 1].t - series[0].t > 2"))
    slide(tab, "smooth.strength", 0.4)
    check("a slider reaches the daemon", tab.until(STATE % "answer.settings['smooth.strength'] === '0.4'"))
    slide(tab, "smooth.lookahead_ms", 200)
    check("a setting that needs a restart waits for the configuration", tab.until("!document.getElementById('write').disabled")
          and tab.ask(STATE % "answer.settings['smooth.lookahead_ms'] === '0.0'"))
    other = Tab(browser, address)
    check("two pages at once", other.until(PICTURES + " > 2") and tab.until(f"{PICTURES} > {tab.ask(PICTURES) + 2}"))
    check("the other page shows the slider's new value", other.until("document.getElementById('set-smooth.strength').value === '0.4'"))
    tab.key("0", "Digit0")
    check("the key 0 switches stabilization off", tab.until(STATE % "answer.settings['stabilize.enabled'] === 'false'"))
    tab.key("0", "Digit0")
    check("and on", tab.until(STATE % "answer.settings['stabilize.enabled'] === 'true'"))
    drag(tab, 0.3)
    check("the mouse moves the divider", tab.until("Math.abs(wipe - 0.3) < 0.01"))
    tab.picture(folder, "daemon")
    for scheme in ("dark", "light"):
        tab.scheme(scheme)
        tab.size(390, 844)
        time.sleep(1)
        tab.picture(folder, f"phone-{scheme}")
        check(f"a phone's width is enough ({scheme})", tab.ask("document.documentElement.scrollWidth <= 390"))
        tab.size(1280, 900)
        time.sleep(1)
        tab.picture(folder, f"daemon-{scheme}")
        ground = tab.ask("getComputedStyle(document.body).backgroundColor")
        check(f"the page is {scheme}", (int(ground.split("(")[1].split(",")[0]) < 128) == (scheme == "dark"))


def recording(browser, address, folder):
    tab = Tab(browser, address)
    check("a recording's page shows pictures", tab.until(PICTURES + " > 0"))
    check("it ends", tab.until(text("play") + " === 'Play'"))
    tab.ask("(() => { const s = document.getElementById('seek'); s.value = 0.4; s.dispatchEvent(new Event('input')); s.dispatchEvent(new Event('change')); })()")
    check("a position is found", tab.until("Math.abs(Number(document.getElementById('seek').value) - 0.4) < 0.05 && last.frames.length > 0"))
    time.sleep(1)
    tab.key("w")
    tab.key("3", "Digit3")
    both = [tab.ask(LEFT), tab.ask(RIGHT)]
    tab.key("1", "Digit1")
    inputs = [tab.ask(LEFT), tab.ask(RIGHT)]
    tab.key("2", "Digit2")
    outputs = [tab.ask(LEFT), tab.ask(RIGHT)]
    check("the wipe shows the input on the left and the output on the right",
          both == [inputs[0], outputs[1]] and inputs[0] != outputs[0] and inputs[1] != outputs[1])
    tab.ask("document.getElementById('stage').focus()")
    tab.key("3", "Digit3")
    tab.key("ArrowLeft")
    check("the arrow keys move the divider", tab.ask("document.getElementById('stage').getAttribute('aria-valuenow')") == "45")
    tab.key("w")
    seen = tab.ask(PICTURES)
    slide(tab, "crop.zoom", 1.5)
    check("a setting changes the paused picture", tab.until(f"{PICTURES} > {seen}"))
    slide(tab, "smooth.lookahead_ms", 100)
    check("so does one that a service would need a restart for", tab.until(STATE % "answer.settings['smooth.lookahead_ms'] === '100.0'"))
    # The page knows it a moment after the server.
    check("both are marked as changed", tab.until("document.querySelectorAll('.changed').length === 2"))
    check("what was changed can be saved or undone", tab.until("!document.getElementById('undo').disabled"))
    tab.picture(folder, "recording")
    tab.ask("document.getElementById('undo').click()")
    check("undo restores both", tab.until(STATE % "answer.settings['smooth.lookahead_ms'] === '0.0' && answer.settings['crop.zoom'] === '1.1'"))
    tab.ask("document.activeElement.blur()")
    tab.key("l")
    tab.key(" ", "Space")
    check("the space key plays, and l loops", tab.until(STATE % "answer.state.playing && answer.state.looping"))
    seen = tab.ask(PICTURES)
    check("it plays from the start again", tab.until(f"{PICTURES} > {seen + 20}") and tab.ask(STATE % "answer.state.playing"))


def report(browser, path, folder):
    tab = Tab(browser, f"file://{path}", 1100, 900)
    check("the report's player shows a picture", tab.until("document.getElementById('picture').width > 300 && !document.getElementById('player').hidden"))
    tab.ask("document.getElementById('play').click()")
    shown = text("time")
    first = tab.ask(shown)
    check("it plays, and the plots' cursors move with it", tab.until(f"{shown} !== {json.dumps(first)}")
          and tab.until("document.querySelector('svg .cursor').getAttribute('x1') > 62"))
    tab.ask("document.getElementById('play').click()")
    box = tab.ask("""(() => { const plot = document.querySelector('svg[data-value]'); plot.scrollIntoView();
        const b = plot.getBoundingClientRect(); return [b.x, b.y, b.width, b.height]; })()""")
    tab.send("Input.dispatchMouseEvent", type="mouseMoved", x=box[0] + 0.5 * box[2], y=box[1] + 0.5 * box[3])
    output = "document.querySelector('svg[data-value]').parentElement.querySelector('output').textContent"
    check("a plot answers to the pointer with time and values", tab.until(f"/^0\\.[3-5]\\d s: camera.* -?[0-9.]+/.test({output})"))
    time_there = tab.ask(output).split(" s")[0]
    check("and the player shows the picture of that time", tab.until(f"{shown}.startsWith('{time_there} s')"))
    before = tab.ask(ALL)
    tab.key("1", "Digit1")
    inputs = tab.ask(ALL)
    tab.key("2", "Digit2")
    check("the keys show before and after", len({before, inputs, tab.ask(ALL)}) == 3)
    tab.picture(folder, "report")
    tab.size(390, 844)
    check("the report fits a phone", tab.until("document.documentElement.scrollWidth <= 390"))
    check("it prints", len(tab.send("Page.printToPDF")["data"]) > 10000)


def service(browser, path, folder):
    tab = Tab(browser, f"file://{path}", 1100, 900)
    check("the service's report shows its pictures", tab.until("document.querySelectorAll('svg image').length === 4")
          and tab.ask("Promise.all([...document.querySelectorAll('svg image')].map(image => image.decode().then(() => true, () => false)))") == [True] * 4)
    halves = "[...document.querySelectorAll('.pair svg')].map(svg => Math.round(svg.getBoundingClientRect().height)).every(height => height > 100)"
    check("input and output are both visible", tab.ask(halves))
    box = tab.ask("""(() => { const plot = document.querySelector('svg[data-value]'); plot.scrollIntoView();
        const b = plot.getBoundingClientRect(); return [b.x, b.y, b.width, b.height]; })()""")
    tab.send("Input.dispatchMouseEvent", type="mouseMoved", x=box[0] + 0.7 * box[2], y=box[1] + 0.5 * box[3])
    output = "document.querySelector('svg[data-value]').parentElement.querySelector('output').textContent"
    check("its plots answer to the pointer, in seconds before the newest frame", tab.until(f"/^-\\d+\\.\\d\\d s: camera.* -?[0-9.]+/.test({output})"))
    tab.picture(folder, "service")
    tab.size(390, 844)
    check("the service's report fits a phone", tab.until("document.documentElement.scrollWidth <= 390"))


def strangers(browser, address):
    host = address.split("/")[2]
    tab = Tab(browser, f"http://{host}/{'0' * 32}/")
    check("another token is refused", tab.until("document.readyState === 'complete'") and tab.ask("document.getElementById('picture') === null"))
    # A page of another origin may neither read the answers nor change anything.
    foreign = Tab(browser, "data:text/html,<title>foreign</title>")
    foreign.until("document.title === 'foreign'")
    script = "fetch(%s, %s).then(() => 'answered', () => 'refused')"
    url = json.dumps(address + "state")
    check("another origin may not read", foreign.ask(script % (url, "{}")) == "refused")
    check("another origin may not change", foreign.ask(script % (json.dumps(address + "set"), '{method: "POST", body: "crop.zoom=1.9"}')) == "refused"
          and foreign.ask(f"fetch({url}, {{mode: 'no-cors'}}).then(answer => answer.type, () => 'refused')") in ("opaque", "refused"))
    foreign.ask(f"fetch({json.dumps(address + 'set')}, {{method: 'POST', mode: 'no-cors', body: 'crop.zoom=1.9'}}).then(() => 1, () => 1)")
    foreign.ask(f"""new Promise(done => {{ const frame = document.createElement('iframe'); frame.src = {json.dumps(address)};
        frame.onload = () => done(1); document.body.append(frame); setTimeout(done, 3000); }})""")
    tab = Tab(browser, address)
    tab.until(PICTURES + " > 0")
    check("it has changed nothing", tab.ask(STATE % "answer.settings['crop.zoom']") != "1.9")


def main():
    program, live, film, page, about_service = sys.argv[1:6]
    folder = sys.argv[6] if len(sys.argv) > 6 else None
    browser = Browser(program)
    try:
        daemon(browser, live, folder)
        recording(browser, film, folder)
        report(browser, page, folder)
        service(browser, about_service, folder)
        # What a refused request leaves in the log is expected; an exception of the page's script is not.
        thrown = [entry for entry in browser.log if "exceptionDetails" in entry]
        check("no script failed", not thrown or print(thrown))
        policy = [entry for entry in browser.log if "Content Security Policy" in json.dumps(entry)]
        check("the page requests nothing that its policy forbids", not policy or print(policy))
        strangers(browser, film)
    finally:
        browser.close()
    sys.exit(1 if failed else 0)


main()
