// The filter of the values page. Its state stands in the address, as in values.html#paper=2014_gsm_2d&verdict=erratum.
const filter = document.querySelector("details.filter");
if (filter) {
  const form = filter.querySelector("form"), table = document.getElementById("values");
  const rows = [...table.querySelectorAll("tr.item")];
  const texts = new Map(rows.map((row) => [row, row.textContent.toLowerCase()]));
  const groups = [...table.querySelectorAll("tbody.group")].map((body) => ({
    body, items: [...body.querySelectorAll("tr.item")], button: body.querySelector(".fold button"), count: body.querySelector(".count"),
  }));
  const fold = (group, open) => group.button?.setAttribute("aria-expanded", open);
  const show = () => {
    const { text, ...chosen } = Object.fromEntries(new FormData(form));
    const words = text.toLowerCase().split(/\s+/);
    const is = (row, name, value) => value === "not reproduced" ? !["reproduced", "within band"].includes(row.dataset[name]) : row.dataset[name] === value;
    const fits = (row) => Object.entries(chosen).every(([name, value]) => !value || is(row, name, value))
      && words.every((word) => texts.get(row).includes(word));
    let all = 0;
    for (const group of groups) {
      const fitting = new Set(group.items.filter(fits));
      all += fitting.size;
      group.body.hidden = !fitting.size;
      const open = group.button?.getAttribute("aria-expanded") !== "false";
      for (const row of group.items) row.hidden = !fitting.has(row) || !open;
      if (group.count) group.count.textContent = fitting.size;
    }
    let shown = false; // whether a paper has a group below its title, seen from the end
    for (const body of [...table.tBodies].reverse()) {
      if (body.className === "paper") { body.hidden = !shown; shown = false; } else shown ||= !body.hidden;
    }
    filter.querySelector("output").textContent = `${all} of ${rows.length}`;
  };
  const read = () => {
    const one = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (location.hash && !location.hash.includes("=")) {
      const group = groups.find((each) => each.items.includes(one));
      if (group) { form.reset(); fold(group, true); show(); one.scrollIntoView(); }
      return;
    }
    const chosen = new URLSearchParams(location.hash.slice(1) || "verdict=not reproduced"); // what a reader comes for
    for (const field of form.elements) if (field.name) field.value = chosen.get(field.name) ?? "";
    show();
  };
  for (const group of groups) {
    fold(group, false);
    group.button?.addEventListener("click", () => { fold(group, group.button.getAttribute("aria-expanded") === "false"); show(); });
  }
  filter.hidden = false;
  filter.open = matchMedia("(min-width: 63em)").matches;
  new ResizeObserver(() => table.style.setProperty("--above", `${filter.offsetHeight}px`)).observe(filter);
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("input", () => {
    show();
    try {
      history.replaceState(null, "", "#" + (new URLSearchParams([...new FormData(form)].filter(([, value]) => value)).toString() || "all="));
    } catch {
      // Some browsers limit how often; the filter works without its address.
    }
  });
  addEventListener("hashchange", read);
  show();
  read();
}
