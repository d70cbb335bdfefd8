"""The built site in Chromium, wide and narrow, light and dark: run by `make site-test`."""

import csv
import json
import re
import threading
from functools import partial
from html import unescape
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from shutil import which
from urllib.parse import parse_qs, unquote, urldefrag, urlencode, urljoin, urlsplit

import numpy as np
import pytest

import mpt_helpers as mpt
from mpt_helpers.ledger.verdicts import CAUSE_KINDS

HTML = Path(__file__).parent / "_build" / "html"
PAGES = [str(path.relative_to(HTML)) for path in sorted(HTML.rglob("*.html"))]
ARTICLES = [place for place in PAGES if re.match(r"notebooks/\w+\.html", place)]
SHORTEST = "2015_mpt_3d"
WIDTHS = {1280: 900, 390: 844}
COUNTED = re.compile(r'href="([^"]*values\.html#[^"]*)">all (\d+)')
CALLS = re.compile(r"paper\.(check|claim|cannot_check)\(")
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
        size = {"width": width, "height": WIDTHS.get(width, 844)}
        contexts.append(browser.new_context(viewport=size, reduced_motion="reduce", **settings))
        page = contexts[-1].new_page()
        page.on("request", request)
        page.on("response", answer)
        page.on("requestfailed", lambda each: wrong.append(f"failed request {each.url}"))
        page.on("console", say)
        page.on("pageerror", lambda error: wrong.append(f"error: {error}"))
        page.goto(address + place)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert wrong == []


@pytest.fixture(scope="session")
def records():
    """Return the verdicts of the site."""
    return json.loads((HTML / "verdicts.json").read_text(encoding="utf-8"))


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
    const style = getComputedStyle(each);
    const colours = [each.closest("svg") ? style.fill : style.color, behind(each)];
    const [low, high] = colours.map(light).sort((a, b) => a - b);
    const contrast = (high + 0.05) / (low + 0.05);
    if (contrast < 4.5) wrong[colours] = `${contrast.toFixed(2)} ${colours} ${each.outerHTML.slice(0, 80)}`;
  }
  return Object.values(wrong);
}"""
# The size on the screen of the smallest text of each figure: its SVG says scale(0.11 -0.11) for 11 points. A limit of
# the figures: matplotlib draws exponents, and what stands in them, at 0.7 of the text's size; they may be that small.
SMALL = r"""async () => {
  const least = { "": 11, "0.7": 0.7 * 11 };
  const wrong = [];
  for (const image of document.querySelectorAll("a.figure img, img.still")) {
    const svg = await (await fetch(image.src)).text();
    const scale = image.getBoundingClientRect().width / Number(svg.match(/viewBox="0 0 ([\d.]+)/)[1]);
    const glyphs = [...new DOMParser().parseFromString(svg, "image/svg+xml").querySelectorAll("use")];
    for (const glyph of glyphs.filter((each) => each.closest("[transform*=' -']"))) {
      const size = Number(glyph.closest("[transform*=' -']").getAttribute("transform").match(/scale\(([\d.]+) -/)[1]);
      const smaller = glyph.getAttribute("transform")?.match(/scale\(([\d.]+)/)?.[1] ?? "";
      const pixels = 100 * size * (smaller || 1) * scale;
      if (!(pixels >= least[smaller])) wrong.push(`${image.src}: ${pixels.toFixed(1)} pixels`);
    }
    if (!glyphs.length) wrong.push(`${image.src}: no text`);
  }
  for (const text of document.querySelectorAll(".live svg text")) {
    if (text.getBoundingClientRect().height < 11) wrong.push(text.outerHTML);
  }
  return wrong;
}"""


def test_there_is_a_site():
    assert {"index.html", "values.html", "figures.html", "guide.html", "api.html"} < set(PAGES)
    assert len(ARTICLES) == 4


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("place", PAGES)
def test_a_page_loads_whole_and_is_readable_in_light_and_dark(visit, place, width):
    if place.endswith("-full.html") and (width, place) != (1280, f"notebooks/{SHORTEST}-full.html"):
        pytest.skip("the full notebooks are for looking things up: one is enough")
    page = visit(place, width, color_scheme="light")
    checks = {"math": TYPESET, "pictures": PICTURES, "sideways": SIDEWAYS, "contrast": UNREADABLE, "small": SMALL}
    assert {name: page.evaluate(check) for name, check in checks.items()} == {name: [] for name in checks}
    page.emulate_media(color_scheme="dark")
    assert page.evaluate(UNREADABLE) == []


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


def test_every_internal_link_leads_somewhere(records):
    pages = {place: Page(HTML / place) for place in PAGES}
    rows = [row | {"place": re.split("[,;]", row["where"])[0]} for row in records]
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
    assert followed > len(records)


def test_a_link_that_says_how_many_opens_as_many_values(visit):
    links = {
        (unescape(link), int(count))
        for place in PAGES
        for link, count in COUNTED.findall((HTML / place).read_text(encoding="utf-8"))
    }
    assert len(links) > 5
    page = visit("values.html")
    for link, count in links:
        page.evaluate(FOLLOW, link)
        assert shown(page)[0] == count, link


@pytest.mark.parametrize("width", WIDTHS)
def test_the_home_page_answers_on_its_first_screen(visit, width):
    page = visit("index.html", width)
    last = ".card:last-child .links" if width == 1280 else ".before li:last-child"
    box = page.locator(last).bounding_box()
    assert box["y"] + box["height"] <= WIDTHS[width]
    assert re.search(r"\d+ of \d+ claims hold", page.locator("h1").inner_text())


@pytest.mark.parametrize("place", ["guide.html", "rinex.html", "speed.html", "accuracy.html"])
def test_wide_code_and_tables_fit_a_wide_window_and_have_a_shadow_on_a_phone(visit, place):
    wide = "all => all.filter((each) => each.scrollWidth > each.clientWidth + 1)"
    parts = ".highlight pre, .table-wrapper"
    assert visit(place).locator(parts).evaluate_all(f"all => ({wide})(all).map((each) => each.textContent)") == []
    shadow = f"all => ({wide})(all).map((each) => getComputedStyle(each).backgroundAttachment)"
    shadows = visit(place, 390).locator(parts).evaluate_all(shadow)
    assert set(shadows) == {"local, local, scroll, scroll, scroll"}


@pytest.mark.parametrize(
    ("heading", "verdicts"),
    [
        ("the-claims-that-fail-or-contradict-their-own-paper", ["differs", "erratum"]),
        ("the-claims-that-cannot-be-checked", ["cannot be checked"]),
    ],
)
def test_home_lists_each_claim_that_fails_or_cannot_be_checked_with_its_reason(visit, records, heading, verdicts):
    def plain(text):  # formulas are set
        return re.sub(r"[_^()]", "", text).lower()

    causes = visit("index.html").locator(f"#{heading} .cause").all()
    own = [row for row in records if row["kind"] == "claim" and row["verdict"] in verdicts]
    listed = [(each.inner_text(), each.locator("strong").inner_text()) for each in causes]
    assert sum(text.count("proof") for text, _ in listed) == len(own) > 0
    for row in own:
        printed = f"{row['where']}: “{row['printed']}” {row['verdict']}"
        (reason,) = {reason for text, reason in listed if plain(printed) in plain(text)}
        causes_of_paper = mpt.published(row["paper"]).causes
        expected = causes_of_paper[row["cause"]].sentence if row["cause"] else row["reason"]
        assert plain(reason) == plain(expected)


def test_a_link_to_the_words_shows_what_each_verdict_basis_and_kind_of_cause_means(visit, records):
    page = visit(visit("index.html").get_by_role("link", name="What they mean").get_attribute("href"))
    words = page.locator("#words dt:visible").all_inner_texts()
    assert set(words) >= {row[name] for row in records for name in ("verdict", "basis")} | set(CAUSE_KINDS)
    assert all(page.locator("#words dd").all_inner_texts())


def test_an_article_has_no_calls_to_the_ledger_and_every_verdict_as_a_chip(visit, records):
    for place in ARTICLES:
        page = visit(place)
        assert not CALLS.search(page.locator("article").inner_text())
        own = [row for row in records if f"notebooks/{row['paper']}.html" == place]
        counts = page.locator(".won summary").evaluate_all(
            r"all => all.map((each) => Number(each.textContent.match(/: (\d+) ×/)?.[1] ?? 1))"
        )
        assert sum(counts) == len(own)
        chip = page.locator(".chip").first
        assert chip.locator("dl").first.is_hidden()
        chip.locator("summary").click()
        assert {"computed", "basis"} < set(chip.locator("dl").first.locator("dt").all_inner_texts())


def test_one_switch_shows_and_hides_all_code(visit):
    page = visit(ARTICLES[0])
    opened = "all => all.filter((each) => each.open).length"
    codes, switch = page.locator("details.code"), page.locator("p.top button")
    count = codes.count()
    for some in (codes.evaluate_all(opened), 1):  # those that are open at first; then one
        assert 0 < codes.evaluate_all(opened) == some < count
        assert switch.inner_text() == "Show all code"
        switch.click()
        assert codes.evaluate_all(opened) == count
        assert switch.inner_text() == "Hide all code"
        switch.click()
        assert codes.evaluate_all(opened) == 0
        codes.first.locator("summary").click()
    page.get_by_role("link", name="The full notebook").click()
    assert page.url.endswith("-full.html")
    assert CALLS.search(page.locator("article").inner_text())


@pytest.mark.parametrize("width", WIDTHS)
def test_a_link_to_a_cell_shows_the_cell_after_the_formulas_above_it_are_set(visit, records, width):
    last = [row for row in records if row["cell"]][-1]
    page = visit(f"notebooks/{last['paper']}.html#cell-{last['cell']}", width)
    page.evaluate("MathJax.startup.promise")
    place = f"document.getElementById('cell-{last['cell']}').getBoundingClientRect().top"
    page.wait_for_function(f"0 <= {place} && {place} < innerHeight", timeout=5000)


@pytest.mark.parametrize("width", WIDTHS)
def test_a_link_to_verdicts_shows_what_stands_above_them(visit, records, width):
    (proved,) = (row for row in records if (row["paper"], row["id"]) == ("2014_gsm_2d", "behaviour.3"))
    page = visit(f"notebooks/{proved['paper']}.html#cell-{proved['cell']}", width)
    page.evaluate("MathJax.startup.promise")
    page.evaluate(f"document.getElementById('cell-{proved['cell']}').scrollIntoView({{behavior: 'instant'}})")
    top = page.evaluate(f"document.getElementById('cell-{proved['cell']}').getBoundingClientRect().top / innerHeight")
    assert 0.5 < top < 0.9


# Open another address of the same page, and wait until it has been read.
FOLLOW = """link => new Promise((done) => {
  const { hash } = new URL(link, location);
  if (location.hash === hash) done();
  addEventListener("hashchange", done, { once: true });
  location.hash = hash;
})"""
LABELS = "all => all.map((each) => getComputedStyle(each, '::before').content)"
# Whether each word of the table's header can be seen, below the filter.
UNCOVERED = """() => [...document.querySelectorAll("#values thead th")].every((each) => {
  const { left, top, height } = each.getBoundingClientRect();
  return top < 300 && document.elementFromPoint(left + 3, top + height / 2) === each;
})"""


def shown(page):
    """Return how many items are counted, and the fields of those that are visible."""
    visible = "rows => rows.filter((row) => row.offsetHeight).map((row) => ({...row.dataset}))"
    count = int(page.locator(".filter output").text_content().split()[0])
    return count, page.locator("#values tr.item").evaluate_all(visible)


@pytest.mark.parametrize("width", WIDTHS)
def test_the_filter_of_the_values_works(visit, records, width):
    page = visit("values.html", width)
    assert shown(page)[0] == len(records)
    if width == 390:
        page.locator(".filter summary").click()
    page.get_by_label("verdict").select_option("erratum")
    page.get_by_label("paper").select_option("2014_gsm_2d")
    page.get_by_label("kind").select_option("number")
    some = [
        row for row in records if (row["paper"], row["verdict"], row["kind"]) == ("2014_gsm_2d", "erratum", "number")
    ]
    count, visible = shown(page)
    assert count == len(some) > len(visible)
    fold = page.locator(".fold:visible button")
    assert fold.count() < 6
    fold.first.click()
    assert fold.first.get_attribute("aria-expanded") == "true"
    assert len(shown(page)[1]) > len(visible)
    page.get_by_label("cause").select_option(some[-1]["cause"])
    assert shown(page)[0] == len([row for row in some if row["cause"] == some[-1]["cause"]])
    again = visit(page.url.rpartition("/")[2], width)
    assert shown(again)[0] == shown(page)[0]
    again.evaluate("location.hash = 'basis=identity'")
    again.wait_for_function("document.querySelector('[name=basis]').value === 'identity'")
    assert shown(again)[0] == len([row for row in records if row["basis"] == "identity"])


@pytest.mark.parametrize("width", [1280, 800, 390])
def test_the_filter_and_the_header_stay_in_view_and_the_columns_stay_where_they_are(visit, width):
    page = visit("values.html", width)
    columns = (
        "() => [...document.querySelectorAll('#values thead th')].map((each) => each.getBoundingClientRect().left)"
    )
    before = page.evaluate(columns)
    page.evaluate("scrollTo(0, document.body.scrollHeight / 2)")
    inside = (
        "all => all.map((each) => each.getBoundingClientRect()).every(({ top, bottom }) => top >= 0 && bottom < 300)"
    )
    page.wait_for_function("scrollY > 1000")
    assert page.locator(".filter summary").evaluate_all(inside)
    header = page.locator("#values thead th").all_text_contents()
    if width == 390:  # there each cell has the word of the header before it
        cells = page.locator("#values .item:not([hidden]) td:not(:empty)")
        assert set(cells.evaluate_all(LABELS)) == {f'"{word}: "' for word in header[1:]}
    else:
        page.wait_for_function(UNCOVERED)
    if width < 1000:
        page.locator(".filter summary").click()
    page.get_by_label("verdict").select_option("cannot be checked")
    assert page.evaluate(columns) == before


def test_a_link_to_one_value_opens_its_row(visit, records):
    folded = [row for row in records if row["paper"] == "2014_gsm_2d" and row["verdict"] == "erratum"][-1]
    page = visit(f"values.html#{folded['paper']}.{folded['id']}")
    assert page.locator(f'[id="{folded["paper"]}.{folded["id"]}"]').is_visible()


def test_the_values_are_a_plain_table_without_javascript(visit, records):
    page = visit("values.html", java_script_enabled=False)
    assert page.locator("#values tr.item:visible").count() == len(records)
    assert page.locator(".filter").is_hidden()


def test_the_tables_for_machines_say_the_same(records):
    with (HTML / "verdicts.csv").open(encoding="utf-8", newline="") as file:
        assert list(csv.DictReader(file)) == records


LIVE = "notebooks/2016_prediction.html"
MAKE = {"cv": mpt.constant_velocity, "gsm": mpt.gsm_axis}


def test_the_live_figure_computes_what_the_package_computes(visit):
    rng = np.random.default_rng(0)
    sets = [
        {"model": model, "dt": 10 ** rng.uniform(-2, 2), "q": 10 ** rng.uniform(-4, 1), "r": 10 ** rng.uniform(-3, 2)}
        for model in MAKE
        for _ in range(100)
    ]
    computed = visit(LIVE).evaluate(
        "sets => sets.map(({ model, dt, q, r }) => { const { K, A, P } = live.steadyState(model, dt, q, r);"
        " return [...K, Math.sqrt(P[0]), live.firOrder(A)]; })",
        sets,
    )
    for each, (*numbers, order) in zip(sets, computed, strict=True):
        steady = mpt.SteadyStateFilter.from_kalman(MAKE[each["model"]](each["dt"], each["q"], each["r"]))
        np.testing.assert_allclose(numbers, [*steady.B[:, 0], np.sqrt(steady.P[0, 0])], rtol=1e-9, err_msg=str(each))
        assert order == mpt.FIRFilter.from_steady_state(steady, tol=1e-3).order, each


@pytest.mark.parametrize("model", MAKE)
def test_the_track_of_the_live_figure_is_filtered_as_by_the_package(visit, model):
    chosen = {"model": model, "dt": 0.7, "q": 0.02, "r": 0.3, "v": 5}
    track = visit(LIVE).evaluate("chosen => live.track({ ...chosen, M: 12 })", chosen)
    axis = MAKE[model](chosen["dt"], chosen["q"], chosen["r"], x0=[0, chosen["v"]])
    kf, z = mpt.KalmanFilter(axis), np.array(track["z"])[:, None]
    np.testing.assert_allclose(track["kalman"], kf.filter(z)[:, 0], rtol=1e-9)
    np.testing.assert_allclose(track["sigma"], np.sqrt(kf.covariances(len(z))[:, 0, 0]), rtol=1e-9)
    steady = mpt.SteadyStateFilter.from_kalman(axis)
    taps = np.array([np.linalg.matrix_power(steady.A, j) @ steady.B for j in range(12)])
    np.testing.assert_allclose(track["fir"], mpt.FIRFilter(axis, taps).filter(z)[:, 0], rtol=1e-9)


@pytest.mark.parametrize("width", WIDTHS)
def test_the_live_figure_follows_keyboard_presets_and_address(visit, width):
    page = visit(LIVE, width)
    slider = page.get_by_label("time step Δt")
    slider.focus()
    said = page.locator(".live .said").inner_text()
    page.keyboard.press("PageUp")
    assert page.locator(".live .said").inner_text() != said
    assert slider.get_attribute("aria-valuetext").endswith(" s")
    again = visit("notebooks/" + page.url.partition("/notebooks/")[2], width)
    assert again.locator(".live .said").inner_text() == page.locator(".live .said").inner_text()
    for preset in again.locator(".presets button").all():
        preset.click()
        assert preset.get_attribute("aria-pressed") == "true"
    assert again.locator(".live .said").inner_text() == said


def test_a_curve_of_the_live_figure_leaves_its_panel_where_the_error_does(visit):
    chosen = {"model": "cv", "dt": 1, "q": 0.01, "r": 0.1, "v": 20, "M": 20}
    page = visit(f"{LIVE}#{urlencode(chosen)}")
    track = page.evaluate("chosen => live.track(chosen)", chosen)
    errors = np.array(track["fir"]) - track["s"]
    curve = page.locator(".live svg").last.locator("path.c1")
    drawn = np.array([float(point.split()[1]) for point in curve.get_attribute("d")[1:].split("L")])
    assert np.ptp(drawn - np.polyval(np.polyfit(errors, drawn, 1), errors)) < 0.3  # the rounding of the path
    clip = curve.get_attribute("clip-path")[5:-1]
    assert page.locator(f"#{clip}").count() == 1
    assert f"its largest error, {np.abs(errors).max():.2g} m, lies outside" in page.locator(".live .said").inner_text()


def test_the_live_figure_says_when_the_track_is_shorter_than_the_rule(visit):
    page = visit(f"{LIVE}#model=cv&dt=0.01&q=0.01&r=0.1&v=20&M=100")
    rule = page.evaluate("live.firOrder(live.steadyState('cv', 0.01, 0.01, 0.1).A)")
    assert rule > page.evaluate("live.STEPS") == 100
    assert page.get_by_label("FIR length").get_attribute("aria-valuetext") == f"all 100 (rule: {rule})"
    assert page.get_by_label("FIR length").get_attribute("max") == "100"


def test_the_live_figure_is_a_picture_without_javascript(visit):
    page = visit(LIVE, java_script_enabled=False)
    assert page.locator(".live img.still").is_visible()
    assert page.locator(".live input").count() == 0
