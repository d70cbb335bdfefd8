"""The built site in Chromium, wide and narrow, light and dark: run by `make site-test`."""

import csv
import json
import threading
from functools import partial
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from shutil import which
from urllib.parse import parse_qs, unquote, urldefrag, urljoin, urlsplit

import pytest

HTML = Path(__file__).parent / "_build" / "html"
PAGES = [str(path.relative_to(HTML)) for path in sorted(HTML.rglob("*.html"))]
WIDTHS = {1280: 900, 390: 844}
QUIET = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
QUIET += ["--disable-component-update", "--disable-sync"]


class Served(SimpleHTTPRequestHandler):
    """A server that says nothing."""

    def log_message(self, *_):
        """Say nothing."""


@pytest.fixture(scope="session")
def browser_type_launch_args():
    """Return what starts Chromium."""
    return {"executable_path": which("chromium"), "args": QUIET}


@pytest.fixture(scope="session")
def address():
    """Serve the built site on this machine."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Served, directory=HTML)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


@pytest.fixture
def visit(browser, address):
    """Open a page, and say at the end of the test whether anything went wrong with loading it."""
    contexts, wrong = [], []

    def request(each):
        if not each.url.startswith((address, "data:")):
            wrong.append(f"outside request {each.url}")

    def answer(each):
        if each.status >= 400:
            wrong.append(f"{each.status} {each.url}")

    def say(each):
        if each.type in ("error", "warning"):
            wrong.append(f"console: {each.text}")

    def open_page(place, width=1280, **settings):
        size = {"width": width, "height": WIDTHS[width]}
        contexts.append(browser.new_context(viewport=size, reduced_motion="reduce", **settings))
        page = contexts[-1].new_page()
        page.on("request", request)
        page.on("response", answer)
        page.on("requestfailed", lambda each: wrong.append(f"failed request {each.url}"))
        page.on("console", say)
        page.on("pageerror", lambda error: wrong.append(f"error: {error}"))
        page.goto(address + place)
        page.wait_for_load_state("networkidle")
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert wrong == []


# What a page can have wrong with it, each as a function of JavaScript that returns a list of what is wrong.
TYPESET = r"""async () => {
  if (window.MathJax) await MathJax.startup.promise;
  const raw = [], walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const text = walk.currentNode;
    if (!text.parentElement.closest("pre, code, script, style, mjx-container")
      && /\$[^$]+\$|\\\(|\\\[|\\begin/.test(text.data)) raw.push(text.data.slice(0, 80));
  }
  const left = [...document.querySelectorAll(".math")].filter((each) => !each.querySelector("mjx-container svg"));
  const failed = [...document.querySelectorAll("mjx-merror, [data-mml-node=merror]")];
  return [...raw, ...[...left, ...failed].map((each) => each.textContent)];
}"""
PICTURES = """async () => {
  const wrong = [];
  for (const image of document.querySelectorAll("img")) {
    image.loading = "eager";
    await image.decode().catch(() => {});
    const sized = image.hasAttribute("width") && image.hasAttribute("height");
    const shown = image.naturalWidth > 0 && image.getBoundingClientRect().width > 100;
    if (!sized || !shown || !image.alt.trim()) wrong.push(image.outerHTML);
  }
  return wrong;
}"""
SIDEWAYS = """() => {
  const scrolls = (each) => !each.matches("article")
    && (["auto", "scroll"].includes(getComputedStyle(each).overflowX) || scrolls(each.parentElement));
  const wide = [...document.querySelectorAll("article *")].filter((each) => !each.closest("mjx-container, thead")
    && each.getBoundingClientRect().right > innerWidth + 1 && !scrolls(each)).map((each) => each.outerHTML);
  const width = document.documentElement.scrollWidth;
  return [...(width > innerWidth ? [`a page of ${width} pixels`] : []), ...wide.slice(0, 3)];
}"""
UNREADABLE = """() => {
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const known = {};
  const rgba = (colour) => known[colour] ??= (canvas.clearRect(0, 0, 1, 1), canvas.fillStyle = colour,
    canvas.fillRect(0, 0, 1, 1), [...canvas.getImageData(0, 0, 1, 1).data]);
  const behind = (each) => {
    for (; each; each = each.parentElement) {
      const colour = getComputedStyle(each).backgroundColor;
      if (rgba(colour)[3] > 200) return colour;
    }
    return "white";
  };
  const light = (colour) => rgba(colour).slice(0, 3).map((part) => part / 255)
    .map((part) => part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4)
    .reduce((sum, part, i) => sum + part * [0.2126, 0.7152, 0.0722][i], 0);
  const wrong = {};
  for (const each of document.querySelectorAll("article *, .sidebar-tree a")) {
    const own = [...each.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
    if (!own || !each.getClientRects().length || each.closest("mjx-container, .headerlink")) continue;
    const colours = [getComputedStyle(each).color, behind(each)];
    const [low, high] = colours.map(light).sort((a, b) => a - b);
    const contrast = (high + 0.05) / (low + 0.05);
    if (contrast < 4.5) wrong[colours] = `${contrast.toFixed(2)} ${colours} ${each.outerHTML.slice(0, 80)}`;
  }
  return Object.values(wrong);
}"""


def test_there_is_a_site():
    assert {"index.html", "values.html", "figures.html", "guide.html", "api.html"} < set(PAGES)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("place", PAGES)
def test_a_page_loads_whole_and_is_readable(visit, place, width, scheme):
    page = visit(place, width, color_scheme=scheme)
    checks = {"math": TYPESET, "pictures": PICTURES, "sideways": SIDEWAYS, "contrast": UNREADABLE}
    assert {name: page.evaluate(check) for name, check in checks.items()} == {name: [] for name in checks}


class Page(HTMLParser):
    """The links and the anchors of a page."""

    def __init__(self, path):
        super().__init__()
        self.links, self.anchors = [], {""}
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        """Note what the tag links to and is called."""
        attributes = dict(attributes)
        self.anchors.add(attributes.get("id", ""))
        self.links += [attributes[name] for name in ("href", "src") if name in attributes]


def test_every_internal_link_leads_somewhere():
    pages = {place: Page(HTML / place) for place in PAGES}
    rows = json.loads((HTML / "verdicts.json").read_text(encoding="utf-8"))
    broken, followed = [], 0
    for place, page in pages.items():
        for link in page.links:
            if urlsplit(link).scheme:
                continue
            target, anchor = urldefrag(urljoin(place, link))
            path = unquote(target.partition("?")[0])
            followed += 1
            if path == "values.html" and "=" in anchor:
                chosen = {name: value for name, (value,) in parse_qs(anchor).items()}
                found = any(chosen.items() <= row.items() for row in rows)
            elif path in pages:
                found = unquote(anchor) in pages[path].anchors
            else:
                found = (HTML / path).is_file()
            if not found:
                broken.append(f"{place}: {link}")
    assert broken == []
    assert followed > len(rows)


def shown(page):
    """Return the papers and verdicts of the rows that are visible."""
    visible = "rows => rows.filter(row => row.offsetHeight).map(row => [row.dataset.paper, row.dataset.verdict])"
    return [tuple(each) for each in page.locator("#values tbody tr").evaluate_all(visible)]


@pytest.mark.parametrize("width", WIDTHS)
def test_a_link_to_a_cell_shows_the_cell_after_the_formulas_above_it_are_set(visit, width):
    *_, last = (row for row in json.loads((HTML / "verdicts.json").read_text(encoding="utf-8")) if row["cell"])
    page = visit(f"notebooks/{last['paper']}.html#cell-{last['cell']}", width)
    page.evaluate("MathJax.startup.promise")
    place = f"document.getElementById('cell-{last['cell']}').getBoundingClientRect().top"
    page.wait_for_function(f"0 <= {place} && {place} < innerHeight / 2", timeout=5000)


@pytest.mark.parametrize("width", WIDTHS)
def test_the_filter_of_the_values_works(visit, width):
    rows = [(row["paper"], row["verdict"]) for row in json.loads((HTML / "verdicts.json").read_text(encoding="utf-8"))]
    page = visit("values.html", width)
    assert shown(page) == rows
    page.get_by_label("verdict").select_option("erratum")
    assert shown(page) == [row for row in rows if row[1] == "erratum"]
    page.get_by_label("paper").select_option("2014_gsm_2d")
    some = [row for row in rows if row == ("2014_gsm_2d", "erratum")]
    assert 0 < len(shown(page)) < len(rows)
    assert shown(page) == some
    assert page.locator("#filter output").inner_text() == f"{len(some)} of {len(rows)}"
    address = page.url
    page.get_by_label("text").fill("eq. 22 z(-15)")
    assert len(shown(page)) == 1
    again = visit(address.rpartition("/")[2], width)
    assert shown(again) == some
    again.evaluate("location.hash = 'verdict=within+band'")
    again.wait_for_function("document.querySelector('[name=verdict]').value === 'within band'")
    assert shown(again) == [row for row in rows if row[1] == "within band"]


def test_the_values_are_a_plain_table_without_javascript(visit):
    rows = json.loads((HTML / "verdicts.json").read_text(encoding="utf-8"))
    page = visit("values.html", java_script_enabled=False)
    assert page.locator("#values tbody tr").count() == len(rows)
    assert page.locator("#filter").is_hidden()


def test_the_tables_for_machines_say_the_same():
    rows = json.loads((HTML / "verdicts.json").read_text(encoding="utf-8"))
    with (HTML / "verdicts.csv").open(encoding="utf-8", newline="") as file:
        assert list(csv.DictReader(file)) == rows
