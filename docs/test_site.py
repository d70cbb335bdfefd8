"""The built site in Chromium, wide and narrow, light and dark: run by `make site-test`."""

import csv
import json
import re
import threading
from functools import partial
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from shutil import which
from urllib.parse import parse_qs, unquote, urldefrag, urlencode, urljoin, urlsplit

import axe_playwright_python
import break_sensor
import corrections
import nbclient
import nbformat
import numpy as np
import pages
import pytest

import mpt_helpers as mpt
import reproduction
from reproduction.ledger import keys, shipped_verdicts
from reproduction.ledger.verdicts import CAUSE_KINDS, HOLDS

HTML = Path(__file__).parent / "_build" / "html"
PAGES = [str(path.relative_to(HTML)) for path in sorted(HTML.rglob("*.html")) if "_static" not in path.parts]
INTERFACE = [place for place in PAGES if re.match(r"api|modules", place)]
ARTICLES = [place for place in PAGES if re.match(r"notebooks/\w+\.html", place)]
LESSONS = [place for place in PAGES if place.startswith("notebooks/lessons/")]
SHORTEST = "2015_mpt_3d"
WIDTHS = {1280: 800, 390: 844}
AXE = (Path(axe_playwright_python.__file__).parent / "axe.min.js").read_text(encoding="utf-8")
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
        if settings.get("java_script_enabled", True):  # without it, scripts that were asked for early are dropped
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
  const wrong = [], walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const text = walk.currentNode;
    if (!text.parentElement.closest("pre, code, script, style")
      && /\$[^$]+\$|\\\(|\\\[|\\begin/.test(text.data)) wrong.push(text.data.slice(0, 80));
  }
  const formulas = [...document.querySelectorAll("math")].filter((each) => each.checkVisibility());
  await document.fonts.ready;
  const loaded = [...document.fonts].filter((each) => each.status === "loaded").map((each) => each.family);
  if (formulas.length && !loaded.some((each) => each.includes("Latin Modern Math"))) wrong.push("no font");
  for (const each of formulas) {
    const { width, height } = each.getBoundingClientRect();
    if (!each.textContent.trim() || each.querySelector("merror") || width < 4 || height < 6) wrong.push(each.outerHTML);
  }
  return wrong;
}"""
PICTURES = """async () => {
  const wrong = [];
  for (const image of document.querySelectorAll(".bd-article img")) {
    image.loading = "eager";
    await image.decode().catch(() => {});
    const sized = image.hasAttribute("width") && image.hasAttribute("height");
    const shown = image.naturalWidth > 0 && image.getBoundingClientRect().width > 100;
    if (!sized || !shown || !image.alt.trim()) wrong.push(image.outerHTML);
  }
  return wrong;
}"""
SIDEWAYS = """() => {
  const scrolls = (each) => !each.matches(".bd-article")
    && (["auto", "scroll"].includes(getComputedStyle(each).overflowX) || scrolls(each.parentElement));
  const wide = [...document.querySelectorAll(".bd-article *")].filter((each) => !each.closest("math, thead")
    && each.getBoundingClientRect().right > innerWidth + 1 && !scrolls(each)).map((each) => each.outerHTML);
  const width = document.documentElement.scrollWidth;
  return [...(width > innerWidth ? [`a page of ${width} pixels`] : []), ...wide.slice(0, 3)];
}"""
# What axe-core finds on a page: contrast with opacity, names, headings, scrollers that no key reaches, small targets.
VIOLATIONS = """async (only) => {
  const rules = { "target-size": { enabled: true } };
  const chosen = only ? { runOnly: only } : { rules };
  const found = await axe.run(document, { resultTypes: ["violations"], preload: false, ...chosen });
  return found.violations.map(({ id, nodes }) => `${id}: ${nodes.map((each) => each.html.slice(0, 120)).join(" | ")}`);
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
    const drawn = /scale\(([\d.]+) -/;
    const sized = (each) => each && (each.getAttribute?.("transform")?.match(drawn)?.[1] ?? sized(each.parentNode));
    for (const glyph of glyphs.filter(sized)) {
      const size = Number(sized(glyph));
      const smaller = glyph.getAttribute("transform")?.match(/scale\(([\d.]+)/)?.[1] ?? "";
      const pixels = 100 * size * (smaller || 1) * scale;
      if (!(pixels >= least[smaller])) wrong.push(`${image.src}: ${pixels.toFixed(1)} pixels`);
    }
    if (!glyphs.length) wrong.push(`${image.src}: no text`);
  }
  for (const text of document.querySelectorAll(".live svg text, .board text")) {
    if (text.getBoundingClientRect().height < 11) wrong.push(text.outerHTML);
  }
  return wrong;
}"""


def test_there_is_a_site():
    assert {"index.html", "ledger.html", "figures.html", "guide.html", "api.html"} < set(PAGES)
    assert len(ARTICLES) == 4
    assert len(LESSONS) == 6


# One template makes all pages of names and modules: those on a phone, where it is narrow.
READ = [(place, width) for place in PAGES for width in WIDTHS if width == 390 or not re.match("(api|modules)/", place)]


@pytest.mark.parametrize(("place", "width"), READ)
def test_a_page_loads_whole_and_everybody_can_read_it_in_light_and_dark(visit, place, width):
    page = visit(place, width, color_scheme="light")
    checks = {"math": TYPESET, "pictures": PICTURES, "sideways": SIDEWAYS, "small": SMALL}
    assert {name: page.evaluate(check) for name, check in checks.items()} == {name: [] for name in checks}
    page.evaluate(AXE)
    assert page.evaluate(VIOLATIONS) == []
    page.emulate_media(color_scheme="dark")
    page.wait_for_function("document.documentElement.dataset.theme === 'dark'")
    assert page.evaluate(VIOLATIONS, ["color-contrast"]) == []


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
    parsed = {place: Page(HTML / place) for place in PAGES}
    rows = [row | {"place": re.split("[,;]", row["where"])[0]} for row in records]
    broken, followed = [], 0
    for place, page in parsed.items():
        for link in page.links:
            if urlsplit(link).scheme:
                continue
            target, anchor = urldefrag(urljoin(place, link))
            path = unquote(target.partition("?")[0])
            followed += 1
            if path == "index.html" and anchor.startswith("sensor="):
                found = anchor.partition("=")[2] in break_sensor.SCENES
            elif path == "ledger.html" and "=" in anchor:
                chosen = {name: value for name, (value,) in parse_qs(anchor).items()}
                found = any(chosen.items() <= row.items() for row in rows)
            elif path in parsed:
                found = unquote(anchor) in parsed[path].anchors
            else:
                found = (HTML / path).is_file()
            if not found:
                broken.append(f"{place}: {link}")
    assert broken == []
    assert followed > len(records)


@pytest.mark.parametrize("width", WIDTHS)
def test_the_first_screen_asks_the_question_and_says_for_whom_and_what_was_found(visit, width):
    page = visit("index.html", width)
    assert page.locator("h1").inner_text().startswith("Four papers on position tracking: do their results hold?")
    for reader in ("students", "recorded track", "readers of the papers", "Python package"):
        assert reader in page.locator("p.for").inner_text()
    for each in ("p.about", "p.for", ".paper-row h2 >> nth=0"):
        box = page.locator(each).bounding_box()
        assert box["y"] + box["height"] <= WIDTHS[width], each
    for place in ("index.html", "guide.html"):  # a page with a list of its sections has a button more
        page = visit(place, width)
        brand, search = (page.locator(each).bounding_box() for each in (".logo__title", ".search-button:visible"))
        assert brand["x"] + brand["width"] + 12 < search["x"]
        assert page.locator(".logo__title").evaluate("each => each.scrollWidth <= each.clientWidth + 1")
    if width == 1280:
        assert page.locator(".bd-header .navbar-nav .nav-link:visible").all_inner_texts() == [
            "Papers and figures",
            "Lessons",
            "Your own track",
            "Filters",
            "Reference",
        ]


@pytest.mark.parametrize("key", keys())
def test_each_table_and_figure_of_a_paper_is_one_click_from_home(visit, key):
    """The link lands on its heading, which names it, near the top of the screen."""
    about = reproduction.published(key).about
    page = visit("index.html")
    row = page.locator(".paper-row", has=page.locator(f"a[href='notebooks/{key}.html']"))
    links = row.locator(".links a:not(.lesson)").evaluate_all("all => all.map((each) => each.getAttribute('href'))")
    assert len(links) == len(about.numbered)
    page = visit(f"notebooks/{key}.html")
    for link, name in zip(links, about.numbered, strict=True):
        heading = page.locator(f"section#{link.partition('#')[2]} > :is(h2, h3)")
        assert re.match(rf"{name}\b", heading.inner_text()), link


@pytest.mark.parametrize("key", keys())
def test_the_contents_of_a_notebook_lead_to_its_headings(visit, key):
    page = visit(f"notebooks/{key}.html")
    links = page.locator(".bd-article table a[href^='#']").evaluate_all(
        "all => all.map((each) => [each.textContent, each.hash])"
    )
    assert len(links) >= len(reproduction.published(key).about.numbered)
    for text, anchor in links:
        assert page.locator(f"section{anchor} > :is(h2, h3)").first.inner_text().startswith(text), text


def test_each_figure_of_each_paper_stands_on_one_page_under_its_number(visit):
    page = visit("figures.html")
    headings = page.locator(".bd-article h3").all_inner_texts()
    assert len(headings) == page.locator("a.figure img").count()
    for key in keys():
        about = reproduction.published(key).about
        for n in range(1, about.figures + 1):
            assert sum(each.startswith(f"Figure {n} of {about.year}: ") for each in headings) == 1, (key, n)
            assert page.locator(f"img[src='figures/{key}_fig{n}.svg']").count() == 1


@pytest.mark.parametrize("place", LESSONS)
def test_a_lesson_is_linked_from_home_and_leads_to_its_paper(visit, place):
    page = visit("index.html")
    assert page.locator(f".bd-article a[href^='{place}']").count() >= 1
    top = visit(place).locator("p.top a", has_text="reproduced")
    assert top.count() == 1


DOORS = {"Your own track": "guide.html", "The filters": "api.html", "Six lessons": "lessons.html"}


@pytest.mark.parametrize("door", DOORS)
def test_a_door_leads_where_its_card_says(visit, door):
    page = visit("index.html")
    assert page.locator(".doors .sd-card-title").all_inner_texts() == list(DOORS)
    assert page.locator(".doors").get_by_role("link", name=door, exact=True).count() == 1
    page.locator(".doors .sd-card", has_text=door).click()
    page.wait_for_url(f"**/{DOORS[door]}")


def test_a_door_is_reached_by_keyboard_and_seen_to_be(visit):
    page = visit("index.html")
    page.locator(".paper-row a").last.focus()
    outline = "each => getComputedStyle(each).outlineStyle + parseFloat(getComputedStyle(each).outlineWidth)"
    for i, door in enumerate(DOORS):
        card = page.locator(".doors .sd-card").nth(i)
        assert card.evaluate(outline).startswith("none")
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.textContent") == door
        assert card.evaluate(outline) == "solid3"


def test_what_a_reader_searches_is_found(visit):
    page = visit("index.html")
    page.keyboard.press("Control+k")
    page.locator("input[type=search]:visible").fill("Lainiotis")
    page.keyboard.press("Enter")
    page.locator("#search-results li a", has_text="LainiotisFilter").first.wait_for()


def test_code_without_a_span_has_the_colour_that_the_span_had():
    styles = (HTML / "_static" / "pygments.css").read_text(encoding="utf-8")
    for theme in ("light", "dark"):
        own = rf'(?m)^html\[data-theme="{theme}"\] \.highlight'
        (base,) = re.findall(own + r" \{[^}]*[; ]color: (#\w+)", styles)
        assert set(re.findall(own + r" \.(?:n|nn|w|p) \{ color: (#\w+) \}", styles)) == {base}
    code = re.findall(r"(?s)<pre>(.*?)</pre>", (HTML / ARTICLES[0]).read_text(encoding="utf-8"))
    assert not [each for each in code if re.search('<span class="(n|nn|w|p)">', each)]
    assert any('<span class="k">' in each for each in code)


def test_code_is_copied_without_prompts_and_outputs(visit):
    page = visit("api.html", permissions=["clipboard-read", "clipboard-write"])
    block = page.locator("div.highlight", has_text="import mpt_helpers as mpt").first
    block.hover()
    block.locator("button.copybtn").click()
    copied = page.evaluate("navigator.clipboard.readText()")
    names = {}
    exec(copied, names)
    assert names["x"].shape == (4, 2)
    page = visit("api/mpt_helpers.KalmanFilter.html", permissions=["clipboard-read", "clipboard-write"])
    block = page.locator("div.highlight", has_text=">>> ").first
    block.hover()
    block.locator("button.copybtn").click()
    copied = page.evaluate("navigator.clipboard.readText()")
    assert ">>>" not in copied
    assert "array(" not in copied


def test_the_bars_of_the_papers_add_up_to_its_verdicts(visit, records):
    cards = visit("index.html").locator(".paper-row").all()
    assert len(cards) == 4
    for card in cards:
        key = re.search(r"notebooks/(\w+)\.html", card.inner_html())[1]
        own = [each for each in records if each["paper"] == key]
        said = re.findall(r"(\d+) ([a-z ]+)", card.locator(".outcome").inner_text())
        counts = {words.strip(): int(count) for count, words in said}
        assert sum(counts.values()) == len(own)
        assert counts["hold"] == sum(each["verdict"] in HOLDS for each in own)
        assert counts.get("fail", 0) == sum(each["verdict"] in ("differs", "erratum") for each in own)


@pytest.mark.parametrize(
    "place", ["guide.html", "speed.html", "api/mpt_helpers.LinearModel.html", f"notebooks/{SHORTEST}.html"]
)
def test_code_on_a_phone_has_13_pixels_and_what_scrolls_is_reached_by_keyboard(visit, place):
    page = visit(place, 390)
    sizes = page.locator(".highlight pre").evaluate_all(
        "all => all.map((each) => parseFloat(getComputedStyle(each).fontSize))"
    )
    assert min(sizes, default=13) >= 13
    unreached = """all => all.filter((each) => each.scrollWidth > each.clientWidth + 1 && each.tabIndex < 0
      && ["auto", "scroll"].includes(getComputedStyle(each).overflowX)).map((each) => each.outerHTML.slice(0, 100))"""
    assert page.locator(".bd-article *").evaluate_all(unreached) == []


def test_the_ledger_says_what_each_verdict_basis_and_kind_of_cause_means(visit, records):
    page = visit("ledger.html")
    page.locator("details.words summary").click()
    words = page.locator("#words dt:visible").all_inner_texts()
    assert set(words) >= {row[name] for row in records for name in ("verdict", "basis")} | set(CAUSE_KINDS)
    assert all(page.locator("#words dd").all_inner_texts())


def test_folded_code_opens_and_is_named_by_its_text(visit):
    page = visit(ARTICLES[0])
    folded = page.locator("details.hide").first
    assert folded.locator("pre").first.is_hidden()
    assert folded.locator("summary").get_attribute("aria-label") is None
    folded.locator("summary").click()
    assert folded.locator("pre").first.is_visible()


def test_the_words_to_correct_are_struck_beside_what_is_right_and_questions_are_asked(visit):
    page = visit("ledger.html")
    given, said = shipped_verdicts(), pages.texts(shipped_verdicts())
    own = [corrections.of(given.of(key), said, key) for key in keys()]
    patches = [patch for each in own for patch, _ in (*each.in_text, *each.if_printed)]
    struck = page.locator(".corrections del").all_inner_texts()
    assert sorted(map(bare, struck)) == sorted(bare(each.printed) for each in patches)
    assert page.locator(".corrections ins").count() == len(patches) > 3
    text = bare(page.locator(".bd-article").inner_text())
    for question in (question for each in own for question in each.questions):
        assert bare(question.text) in text


def bare(text):
    """Return a text without what is typeset: indices, powers, brackets around them, and breaks."""
    return " ".join(re.sub(r"[_^()]", "", text).split())


@pytest.mark.parametrize("width", WIDTHS)
def test_a_link_to_a_cell_shows_the_cell(visit, records, width):
    last = [row for row in records if row["cell"]][-1]
    page = visit(f"notebooks/{last['paper']}.html#cell-{last['cell']}", width)
    place = f"document.getElementById('cell-{last['cell']}').getBoundingClientRect().top"
    page.wait_for_function(f"0 <= {place} && {place} < innerHeight", timeout=5000)


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
  return top < 400 && document.elementFromPoint(left + 3, top + height / 2) === each;
})"""


def shown(page):
    """Return how many items are counted, and the fields of those that are visible."""
    visible = "rows => rows.filter((row) => row.offsetHeight).map((row) => ({...row.dataset}))"
    count = int(page.locator(".filter output").text_content().split()[0])
    return count, page.locator("#values tr.item").evaluate_all(visible)


@pytest.mark.parametrize("width", WIDTHS)
def test_the_filter_of_the_values_works(visit, records, width):
    page = visit("ledger.html", width)
    assert shown(page)[0] == len([row for row in records if row["verdict"] not in HOLDS])
    if width == 390:
        page.locator(".filter summary").click()
    page.locator("[name=verdict]").select_option("")
    assert shown(page)[0] == len(records)
    assert (
        visit(page.url.rpartition("/")[2], width).locator(".filter output").inner_text()
        == page.locator(".filter output").inner_text()
    )
    page.locator("[name=verdict]").select_option("erratum")
    page.locator("[name=paper]").select_option("2014_gsm_2d")
    page.locator("[name=kind]").select_option("number")
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
    page.locator("[name=cause]").select_option(some[-1]["cause"])
    assert shown(page)[0] == len([row for row in some if row["cause"] == some[-1]["cause"]])
    again = visit(page.url.rpartition("/")[2], width)
    assert shown(again)[0] == shown(page)[0]
    again.evaluate("location.hash = 'basis=identity'")
    again.wait_for_function("document.querySelector('[name=basis]').value === 'identity'")
    assert shown(again)[0] == len([row for row in records if row["basis"] == "identity"])


@pytest.mark.parametrize("width", [1280, 800, 390])
def test_the_filter_and_the_header_stay_in_view_and_the_columns_stay_where_they_are(visit, width):
    page = visit("ledger.html", width)
    columns = (
        "() => [...document.querySelectorAll('#values thead th')].map((each) => each.getBoundingClientRect().left)"
    )
    before = page.evaluate(columns)
    page.evaluate("scrollTo(0, document.body.scrollHeight / 2)")
    inside = (
        "all => all.map((each) => each.getBoundingClientRect()).every(({ top, bottom }) => top >= 0 && bottom < 400)"
    )
    page.wait_for_function("scrollY > 1000")
    assert page.locator(".filter summary").evaluate_all(inside)
    header = page.locator("#values thead th").all_text_contents()
    if width == 390:  # there each cell has the word of the header before it
        cells = page.locator("#values .item:not([hidden]) td:not(:empty)")
        assert set(cells.evaluate_all(LABELS)) <= {f'"{word}: "' for word in header[1:]}
    else:
        page.wait_for_function(UNCOVERED)
    if width < 1000:
        page.locator(".filter summary").click()
    page.locator("[name=verdict]").select_option("cannot be checked")
    assert page.evaluate(columns) == before


def test_what_fails_stands_before_what_holds_under_a_condition_and_beyond_has_its_column(visit, records):
    page = visit("ledger.html#all=")
    order = ["erratum", "differs", "holds in part", "cannot be checked", "within band", "reproduced"]
    for key in {row["paper"] for row in records}:
        verdicts = page.locator(f"#values tr.item[data-paper='{key}']").evaluate_all(
            "all => all.map((each) => each.dataset.verdict)"
        )
        ranks = [order.index(each) for each in verdicts]
        # Rows that share table, outcome and cause stand together; apart from those the order is that of the verdicts.
        assert ranks == sorted(ranks)
    beyond = page.locator("#values td[data-label^=beyond]").evaluate_all(
        "all => all.map((each) => each.textContent.trim() !== '')"
    )
    assert sum(beyond) == sum(row["beyond"] != "" for row in records)


def test_a_link_to_one_value_opens_its_row(visit, records):
    folded = [row for row in records if row["paper"] == "2014_gsm_2d" and row["verdict"] == "reproduced"][-1]
    page = visit(f"ledger.html#{folded['paper']}.{folded['id']}")
    assert page.locator(f'[id="{folded["paper"]}.{folded["id"]}"]').is_visible()


def test_the_values_are_a_plain_table_without_javascript(visit, records):
    page = visit("ledger.html", java_script_enabled=False)
    assert page.locator("#values tr.item:visible").count() == len(records)
    assert page.locator(".filter").is_hidden()


def test_the_tables_for_machines_say_the_same(records):
    with (HTML / "verdicts.csv").open(encoding="utf-8", newline="") as file:
        assert list(csv.DictReader(file)) == records


LIVE = "small_processor.html"
MAKE = {"cv": mpt.constant_velocity, "gsm": mpt.gsm_axis}


def test_the_live_figure_computes_what_the_package_computes(visit):
    rng = np.random.default_rng(0)
    sets = [
        {"model": model, "dt": 10 ** rng.uniform(-2, 2), "q": 10 ** rng.uniform(-4, 1), "r": 10 ** rng.uniform(-3, 2)}
        for model in MAKE
        for _ in range(100)
    ]
    computed = visit(LIVE).evaluate(
        "sets => sets.map(({ model, dt, q, r }) => { const { K, A, P } = live.steadyState({ model, dt, q, r });"
        " return [...K, Math.sqrt(P[0]), kalman.order(A)]; })",
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
    page.keyboard.press("Tab")
    assert page.locator(".live .said").inner_text() != said
    assert slider.get_attribute("aria-valuetext").endswith(" s")
    again = visit(page.url.rpartition("/")[2], width)
    assert again.locator(".live .said").inner_text() == page.locator(".live .said").inner_text()
    for preset in again.locator(".presets button").all():
        preset.click()
        assert preset.get_attribute("aria-pressed") == "true"
    assert again.locator(".live .said").inner_text() == said


@pytest.mark.parametrize("width", WIDTHS)
def test_the_panels_of_the_live_figure_stand_side_by_side_where_there_is_room_with_letters_of_one_size(visit, width):
    page = visit(LIVE, width)
    first, second, third = (each.bounding_box() for each in page.locator(".live .panels svg").all())
    assert (second["y"] == third["y"]) is (width == 1280)
    assert first["y"] + first["height"] <= second["y"]
    scale = "all => all.map((each) => each.getBoundingClientRect().width / each.viewBox.baseVal.width)"
    for each in page.locator(".live .panels svg").evaluate_all(scale):
        assert each == pytest.approx(1, abs=0.05)


def test_a_curve_of_the_live_figure_leaves_its_panel_where_the_error_does(visit):
    chosen = {"model": "cv", "dt": 1, "q": 0.01, "r": 0.1, "v": 20, "M": 20}
    page = visit(f"{LIVE}#{urlencode(chosen)}")
    track = page.evaluate("chosen => live.track(chosen)", chosen)
    errors = np.array(track["fir"]) - track["s"]
    curve = page.locator(".live svg").first.locator("path.c1")
    drawn = np.array([float(point.split()[1]) for point in curve.get_attribute("d")[1:].split("L")])
    assert np.ptp(drawn - np.polyval(np.polyfit(errors, drawn, 1), errors)) < 0.3  # the rounding of the path
    clip = curve.get_attribute("clip-path")[5:-1]
    assert page.locator(f"#{clip}").count() == 1
    assert f"its largest error, {np.abs(errors).max():.2g} m, lies outside" in page.locator(".live .said").inner_text()


def test_the_live_figure_says_when_the_track_is_shorter_than_the_rule(visit):
    page = visit(f"{LIVE}#model=cv&dt=0.01&q=0.01&r=0.1&v=20&M=100")
    rule = page.evaluate("kalman.order(live.steadyState({ model: 'cv', dt: 0.01, q: 0.01, r: 0.1 }).A)")
    assert rule > page.evaluate("live.STEPS") == 100
    assert page.get_by_label("FIR length").get_attribute("aria-valuetext") == f"all 100 (rule: {rule})"
    assert page.get_by_label("FIR length").get_attribute("max") == "100"


def test_the_live_figure_is_a_picture_without_javascript(visit):
    page = visit(LIVE, java_script_enabled=False)
    assert page.locator(".live img.still").is_visible()
    assert page.locator(".live input").count() == 0


NO_MORE_ADDRESSES = """() => {
  history.replaceState = () => { throw new DOMException("too many", "SecurityError"); };
}"""


def test_the_figures_are_drawn_where_the_address_cannot_be_written(visit):
    """Some browsers allow a hundred changes in half a minute, then replaceState throws."""
    page = visit(LIVE)
    page.evaluate(NO_MORE_ADDRESSES)
    said = page.locator(".live .said").inner_text()
    slider = page.get_by_label("time step Δt")
    slider.focus()
    page.keyboard.press("PageUp")
    assert page.locator(".live .said").inner_text() != said
    page = visit("index.html#sensor=gap")
    page.evaluate(NO_MORE_ADDRESSES)
    page.locator("[data-scene=far]").click()
    assert page.locator(".sensor .said").inner_text() == break_sensor.said("far")


def test_an_address_is_written_when_a_slider_is_let_go_and_not_before(visit):
    page = visit(LIVE)
    page.evaluate("() => { window.written = 0; history.replaceState = () => { window.written += 1; }; }")
    page.get_by_label("time step Δt").scroll_into_view_if_needed()
    box = page.get_by_label("time step Δt").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    for step in range(20):
        page.mouse.move(box["x"] + box["width"] / 2 + 4 * step, box["y"] + box["height"] / 2)
    assert page.evaluate("window.written") == 0
    page.mouse.up()
    assert page.evaluate("window.written") == 1


# The sensor to break.


def test_the_sensor_computes_what_the_package_computes(visit):
    """x, P, K and NIS of Kalman and of the constant gain, and x of FIR, with random gaps, both H and far origins."""
    page = visit("index.html")
    given = page.evaluate("JSON.parse(document.querySelector('.sensor').dataset.sensor)")
    rng = np.random.default_rng(0)
    for case in range(30):
        scene = break_sensor.Scene(ahead=bool(case % 2), origin=float(rng.choice([0, 3000])))
        kf, steady, fir = break_sensor.filters(scene.ahead, scene.origin)
        z = scene.origin + np.cumsum(rng.normal(1.5, 1, break_sensor.FIXES))
        z[rng.random(len(z)) < rng.choice([0, 0.1, 0.5])] = np.nan
        measured = [None if np.isnan(each) else each for each in z]
        made = page.evaluate(
            "([z, given]) => sensor.run(z, given)", [measured, given | {"ahead": scene.ahead, "origin": scene.origin}]
        )
        for name, each in (("kalman", kf), ("constant", steady)):
            P = each.covariances(z[:, None])
            close = partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-9, err_msg=f"{case} {name}")
            close(made[name]["x"], each.filter(z[:, None]))
            close(made[name]["P"], np.column_stack([P[:, 0, 0], P[:, 0, 1], P[:, 1, 1]]))
            nis = [np.nan if value is None else value for value in made[name]["nis"]]
            close(nis, mpt.metrics.nis(each, z[:, None]))
            gains = np.array([K for K in made[name]["K"] if K is not None])
            own = P @ kf.model.H.T / kf.model.R if name == "kalman" else np.broadcast_to(steady.B, (len(z), 2, 1))
            close(gains, own[~np.isnan(z), :, 0])
        np.testing.assert_allclose(made["fir"], fir.filter(z[:, None]), rtol=1e-9, atol=1e-9)
        assert made["order"] == fir.order


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("scene", break_sensor.SCENES)
def test_each_scene_takes_one_tap_and_says_what_the_package_says(visit, scene, width):
    page = visit("index.html", width)
    page.locator(".sensor summary").click()
    page.locator(f"[data-scene={scene}]").click()
    assert page.locator(".sensor .said").inner_text() == break_sensor.said(scene)
    seen = break_sensor.run(break_sensor.SCENES[scene], break_sensor.average())
    red = page.locator(".board path.outside").get_attribute("d").count("M")
    assert red == (np.abs(seen.kalman) > 2 * seen.sigma).sum()
    assert page.url.endswith(f"#sensor={scene}")
    panel = page.locator(".board").bounding_box()
    labels = page.locator(".board .label").all()
    assert labels
    boxes = [each.bounding_box() for each in labels]
    for box in boxes:  # inside the panel, at every width
        assert panel["x"] <= box["x"]
        assert box["x"] + box["width"] <= panel["x"] + panel["width"] + 1
    words = " ".join(each.text_content() for each in labels)
    assert " ".join(break_sensor.BAND_IS) in words
    assert (" ".join(break_sensor.RED_IS) in words) is (red > 0)
    for i, one in enumerate(boxes):  # two lines of a label have 15 pixels each
        for other in boxes[:i]:
            apart = max(one["x"] - other["x"] - other["width"], other["x"] - one["x"] - one["width"]) >= 0
            assert apart or abs(one["y"] - other["y"]) > 11


def test_the_figure_opens_on_a_gap_and_says_it_without_a_touch(visit):
    for settings in ({}, {"java_script_enabled": False}):
        page = visit("index.html", 390, **settings)
        assert page.locator(".sensor .said").inner_text() == break_sensor.said("gap")
    still = page.locator(".sensor img.still").bounding_box()
    panel = page.locator(".sensor").bounding_box()
    assert panel["x"] <= still["x"]
    assert still["x"] + still["width"] <= panel["x"] + panel["width"]
    assert page.locator(".scenes button").count() == 0
    page.locator(".sensor summary").click()
    assert "Drag" not in page.locator(".sensor").inner_text()


def test_the_figure_fits_a_phone_has_no_sliders_and_does_not_move_by_itself(visit):
    page = visit("index.html", 390)
    assert page.locator(".sensor").bounding_box()["height"] < WIDTHS[390] - 56  # the header stays in view
    assert page.locator(".sensor input").count() == 0
    page.locator(".sensor summary").click()
    page.locator("[data-scene=outlier]").click()
    assert page.evaluate("document.getAnimations().length") == 0


def fixes(page, kind):
    """Return the numbers of the fixes that are drawn as `kind`."""
    return [
        int(each) for each in page.locator(f".board .{kind}").evaluate_all("all => all.map((each) => each.dataset.fix)")
    ]


def dot(page, fix):
    """Return where a fix is drawn."""
    box = page.locator(f".board [data-fix='{fix}']").bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


@pytest.mark.parametrize("width", WIDTHS)
def test_dragging_along_loses_pulling_breaks_and_a_tap_restores(visit, width):
    page = visit("index.html#sensor=far", width)
    page.locator(".board").scroll_into_view_if_needed()
    x, y = dot(page, 25)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(dot(page, 29)[0], y, steps=5)
    page.mouse.up()
    assert fixes(page, "missing") == [25, 26, 27, 28, 29]
    assert page.locator(".sensor .said").inner_text().startswith("After 5 missing fixes")
    x, y = dot(page, 45)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y - 50, steps=5)
    page.mouse.up()
    assert fixes(page, "pulled") == [45]
    assert page.locator(".sensor .said").inner_text().startswith("Fix 45 is")
    link = page.url.partition("/index.html")[2]
    assert re.fullmatch(r"#sensor=far&lost=25-29&pulled=45:\d(\.\d)?", link)
    again = visit(f"index.html{link}", width)
    assert (fixes(again, "missing"), fixes(again, "pulled")) == ([25, 26, 27, 28, 29], [45])
    for fix in (27, 45):
        page.mouse.click(*dot(page, fix))
    assert (fixes(page, "missing"), fixes(page, "pulled")) == ([25, 26, 28, 29], [])
    page.mouse.click(*dot(page, 10))  # a fix that is there stays there
    assert fixes(page, "missing") == [25, 26, 28, 29]


def test_keys_do_what_a_finger_does(visit):
    page = visit("index.html#sensor=far")
    board = page.get_by_role("slider", name="fixes")
    board.focus()
    page.keyboard.press("Home")
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    page.keyboard.press("Space")
    assert fixes(page, "missing") == [5]
    assert board.get_attribute("aria-valuetext") == "fix 5, lost"
    page.keyboard.press("ArrowUp")
    assert (fixes(page, "missing"), fixes(page, "pulled")) == ([], [5])
    assert page.url.partition("pulled=")[2].startswith("5:")
    page.keyboard.press("Escape")
    assert fixes(page, "pulled") == []


def test_a_vertical_swipe_scrolls_off_the_dots_and_not_on_them(visit):
    page = visit("index.html", 390, has_touch=True, is_mobile=True)
    page.evaluate("document.querySelector('.board').scrollIntoView({block: 'center', behavior: 'instant'})")
    session = page.context.new_cdp_session(page)

    def swipe(x, y):
        before = page.evaluate("scrollY")
        touch = {"x": x, "y": y}
        session.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [touch]})
        for step in range(1, 13):
            session.send(
                "Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [touch | {"y": y - 10 * step}]}
            )
        session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        page.wait_for_timeout(300)
        return page.evaluate("scrollY") - before

    x, y = dot(page, 46)
    assert swipe(x, y) == 0
    assert fixes(page, "pulled") == [46]
    bottom = page.locator(".board").bounding_box()
    assert swipe(x, bottom["y"] + bottom["height"] - 8) > 50


# What holds of every page.

LONG_LINES = """() => {
  const wrong = [], range = document.createRange();
  for (const block of document.querySelectorAll(".bd-article :is(p, li)")) {
    const walk = document.createTreeWalker(block, NodeFilter.SHOW_TEXT), lines = {};
    while (walk.nextNode()) {
      if (walk.currentNode.parentElement.closest("math, details:not([open])")) continue;
      for (let i = 0; i < walk.currentNode.length; i++) {
        range.setStart(walk.currentNode, i);
        range.setEnd(walk.currentNode, i + 1);
        const box = range.getBoundingClientRect(), line = Math.round((box.top + box.bottom) / 16);
        lines[line] = (lines[line] ?? "") + walk.currentNode.data[i];
      }
    }
    wrong.push(...Object.values(lines).filter((line) => line.trim().length > 92));
  }
  return wrong;
}"""


@pytest.mark.parametrize(
    "place", ["index.html", "guide.html", "rinex.html", "accuracy.html", f"notebooks/{SHORTEST}.html", "speed.html"]
)
def test_lines_of_text_have_some_eighty_characters(visit, place):
    """None has more than 92: eighty, where all letters are as wide as an average one."""
    assert visit(place).evaluate(LONG_LINES) == []


def test_the_notation_wraps_on_a_phone(visit):
    wrapper = visit("api.html", 390).locator("#notation .pst-scrollable-table-container")
    assert wrapper.evaluate("each => each.scrollWidth <= each.clientWidth + 1")


@pytest.mark.parametrize("place", [each for each in PAGES if each != "search.html"])
def test_a_page_says_in_its_head_what_it_is_about(place):
    text = (HTML / place).read_text(encoding="utf-8")
    (said,) = re.findall(r'<meta content="([^"]*)" name="description"', text)
    assert 40 < len(said) < 400


FAINT_BARS = r"""() => {
  const rgb = (colour) => colour.match(/[\d.]+/g).map(Number);
  const light = (colour) => rgb(colour).slice(0, 3).map((part) => part / 255)
    .map((part) => part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4)
    .reduce((sum, part, i) => sum + part * [0.2126, 0.7152, 0.0722][i], 0);
  const page = getComputedStyle(document.body).backgroundColor;
  return [...document.querySelectorAll(".bar > span")].map((each) => {
    const [low, high] = [getComputedStyle(each).backgroundColor, page].map(light).sort((a, b) => a - b);
    return (high + 0.05) / (low + 0.05);
  }).filter((contrast) => contrast < 3);
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_bars_can_be_told_from_the_page(visit, scheme):
    page = visit("index.html", color_scheme=scheme)
    assert page.locator(".bar > span").count() > 8
    assert page.evaluate(FAINT_BARS) == []


def test_on_paper_nothing_covers_the_text_and_bars_are_printed(visit):
    page = visit("index.html")
    page.emulate_media(media="print")
    assert page.locator(".bd-header").is_hidden()
    adjust = "all => all.map((each) => getComputedStyle(each).printColorAdjust)"
    assert set(page.locator(".bar > span").evaluate_all(adjust)) == {"exact"}


@pytest.mark.parametrize("place", ["guide.html", *ARTICLES])
def test_a_long_page_has_a_list_of_its_sections_beside_it_and_on_a_phone_behind_a_button(visit, place):
    assert visit(place).locator("#pst-page-toc-nav a:visible, .page-toc a:visible").count() >= 3
    page = visit(place, 390)
    page.locator("button.secondary-toggle:visible").click()
    assert page.locator(".page-toc a:visible").count() >= 3


# What is weighed and counted.


WEIGHT = """() => [...performance.getEntriesByType("navigation"), ...performance.getEntriesByType("resource")]
  .map(({ name, decodedBodySize }) => [new URL(name).pathname.slice(1), decodedBodySize])"""


@pytest.mark.parametrize("place", ARTICLES)
def test_an_article_weighs_less_than_800_kilobytes_when_it_is_opened(visit, place):
    """Without what all pages share by the theme; pictures further down come when they are scrolled to."""
    docs = Path(__file__).parent
    ours = {f"_static/{path.name}" for folder in ("_static", "_build/static") for path in (docs / folder).iterdir()}
    page = visit(place)
    page.wait_for_load_state("networkidle")
    loaded = page.evaluate(WEIGHT)
    own = {name: size for name, size in loaded if name in ours or not name.startswith("_static/")}
    assert place in own
    assert ("_static/latinmodern-math.woff2" in own) == (page.locator("math").count() > 0)
    assert sum(own.values()) < 800_000


@pytest.mark.parametrize("name", [path.stem for path in sorted(HTML.glob("*.ipynb"))])
def test_a_guide_is_a_notebook_that_runs_and_prints_where_it_says_so(tmp_path, name):
    (tmp_path / "tracks").symlink_to(HTML / "tracks")
    notebook = nbformat.read(HTML / f"{name}.ipynb", as_version=4)
    code = [each for each in notebook.cells if each.cell_type == "code"]
    said = [any(out.output_type == "stream" for out in each.outputs) for each in code]
    draws = [each.source.endswith("\nfig") for each in code]
    assert len(code) > 3
    assert any(draws)
    assert "pip install" in notebook.cells[0].source
    prose = "\n".join(each.source for each in notebook.cells if each.cell_type == "markdown")
    assert re.findall(r"\]\((?!https?:|data:)[^)]*\)|href=\"(?!https?:)", prose) == []  # they would be dead
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    printed = ["".join(out.text for out in each.outputs if out.get("name") == "stdout") for each in code]
    # What it prints to the byte is held by the tests of the guide.
    assert [bool(each) for each in printed] == said
    pictures = [sum("image/png" in out.get("data", {}) for out in each.outputs) for each in code]
    assert pictures == draws
