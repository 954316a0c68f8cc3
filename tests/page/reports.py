"""Opens reports in Chromium and checks for visible faults.

Usage: look.py STICTIOND CHROMIUM [FOLDER FOR SCREENSHOTS]
"""

import pathlib
import subprocess
import sys
import tempfile

from playwright.sync_api import sync_playwright

LONG = "UNIT-4711_DISTILLATION-COLUMN-TOP-REFLUX-DRUM-LEVEL-CONTROLLER_LIC-20417-A"
LOOPS = 300

# The faults of the open page; the list should be empty.
LOOK = """
() => {
  const faults = [];
  const root = document.documentElement;
  if (root.scrollWidth > root.clientWidth) faults.push(`page overflows: ${root.scrollWidth} over ${root.clientWidth}`);
  const plots = [...document.querySelectorAll('svg.plot')].filter((svg) => svg.checkVisibility());
  for (const svg of plots) {
    const name = svg.getAttribute('aria-label');
    const box = svg.getBoundingClientRect();
    if (box.width < 100 || box.height < 40) faults.push(`${name}: ${box.width} x ${box.height}`);
    const texts = [...svg.querySelectorAll('text')].map((t) => [t.textContent.trim(), t.getBoundingClientRect()]);
    for (const [text, at] of texts) {
      if (at.left < box.left - 1 || at.right > box.right + 1 || at.top < box.top - 1 || at.bottom > box.bottom + 1)
        faults.push(`${name}: "${text}" is cut off`);
    }
    for (const [k, [text, a]] of texts.entries())
      for (const [other, b] of texts.slice(k + 1)) {
        const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
        const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
        if (wide > 1 && high > 0.35 * Math.min(a.height, b.height)) faults.push(`${name}: "${text}" covers "${other}"`);
      }
  }
  for (const part of document.querySelectorAll('h1, dd, .headline, summary, pre')) {
    if (part.checkVisibility() && part.scrollWidth > part.clientWidth + 1)
      faults.push(`<${part.tagName}> is cut off: ${part.textContent.trim().slice(0, 60)}`);
  }
  return { faults, plots: plots.length };
}
"""


def scenario(names, seconds):
    """A scenario of small loops, half of them sticking."""
    head = '[site]\nprefix = "many"\n\n[run]\nstart = "2026-01-06T00:00:00Z"\n'
    head += f"duration_s = {seconds}\nts_s = 1.0\nseed = 3\nwarmup_s = 600.0\n"
    loops = []
    for k, name in enumerate(names):
        valve = 'valve = { law = "he", fs = 4.0, fd = 1.5 }' if k % 2 else ""
        loops.append(f"""
[[loop]]
name = "{name}"
label = "stiction"
note = "One of many."
operating_point = {{ op = 50.0, pv = 60.0 }}
setpoint = 61.0
process = {{ gain = 2.0, time_constants_s = [{6 + k % 7}.0], dead_time_s = 3.0 }}
controller = {{ kc = 0.6, ti_s = 4.0, op_resolution = 0.01 }}
{valve}
noise = {{ pv_sd = 0.05 }}
recording = {{ signals = ["op", "pv", "sp"], pv_quantum = 0.01 }}
""")
    return head + "".join(loops)


def make(program, folder):
    """The reports to check, by name."""

    def run(*arguments):
        done = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True)
        assert done.returncode == 0, f"{arguments}: {done.stderr}"

    def simulated(name, names, seconds):
        toml = folder / f"{name}.toml"
        toml.write_text(scenario(names, seconds))
        run("simulate", toml, "--out", folder / f"{name}.mcap")
        return folder / f"{name}.mcap"

    recording = "recordings/sticking.mcap"
    one, long, many = folder / "one.html", folder / "long.html", folder / "many.html"
    run("analyze", recording, "--op-range", "0,100", "--report", one)
    run("analyze", recording, "--op-range", "0,100", "--report", folder / "one.svg")
    run("analyze", simulated("long", [LONG, "B"], 400), "--report", long)
    run("analyze", simulated("many", [f"AREA7-FIC{k:03}" for k in range(LOOPS)], 60), "--report", many)
    return [one, long, many, folder / "one.svg"]


def main():
    program, browser = sys.argv[1:3]
    shots = pathlib.Path(sys.argv[3]) if len(sys.argv) > 3 else None
    failures = []
    with tempfile.TemporaryDirectory() as temporary, sync_playwright() as playwright:
        reports = make(program, pathlib.Path(temporary))
        chromium = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        for report in reports:
            for width in (1280, 390):
                for scheme in ("light", "dark"):
                    view = {"width": width, "height": 900}
                    page = chromium.new_page(viewport=view, color_scheme=scheme)
                    said = []
                    page.on("console", lambda message, said=said: said.append(f"console: {message.text}"))
                    page.on("pageerror", lambda error, said=said: said.append(f"script: {error}"))
                    page.on("request", lambda r, said=said: r.url.startswith("file:") or said.append(f"fetched {r.url}"))
                    page.goto(report.as_uri())
                    name = f"{report.name} at {width} {scheme}"
                    if report.suffix == ".html":
                        found = page.evaluate(LOOK)
                        said += found["faults"]
                        if report.stem == "many":
                            rows = page.locator(".overview tbody tr").count()
                            if rows != LOOPS:
                                said.append(f"{rows} rows, not {LOOPS}")
                            page.locator(".overview a").nth(20).click()
                            page.wait_for_timeout(100)
                            if page.locator("details.loop[open]").count() != 1:
                                said.append("a link of the overview opens no loop")
                            said += page.evaluate(LOOK)["faults"]
                        elif report.stem == "long":
                            page.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
                            said += page.evaluate(LOOK)["faults"]
                            # In print every loop is shown, including those folded on the screen.
                            page.reload()
                            sheets = page.pdf().count(b"/Type /Page\n") if (width, scheme) == (1280, "light") else 99
                            if sheets < 8:
                                said.append(f"printed, two loops are {sheets} pages")
                        elif found["plots"] < 10:
                            said.append(f"only {found['plots']} pictures")
                        paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
                        if (paper == "rgb(255, 255, 254)") != (scheme == "light"):
                            said.append(f"paper is {paper}")
                    if shots:
                        shots.mkdir(parents=True, exist_ok=True)
                        page.screenshot(path=shots / f"{report.stem}-{report.suffix[1:]}-{width}-{scheme}.png",
                                        full_page=report.stem != "many" and report.suffix == ".html", timeout=0)
                    failures += [f"{name}: {fault}" for fault in dict.fromkeys(said)]
                    page.close()
        chromium.close()
    for failure in failures:
        print(failure)
    if failures:
        sys.exit(1)
    print(f"reports hold in a browser: {len(reports)} files, two widths, light and dark")


if __name__ == "__main__":
    main()
