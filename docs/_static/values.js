// The filter of the values page. Its state stands in the address, as in values.html#paper=2014_gsm_2d&verdict=erratum.
const form = document.getElementById("filter");
if (form) {
  const rows = [...document.querySelectorAll("#values tbody tr")];
  const show = () => {
    const { paper, verdict, text } = Object.fromEntries(new FormData(form));
    const words = text.toLowerCase().split(/\s+/);
    for (const row of rows) {
      const content = row.textContent.toLowerCase();
      row.hidden = (paper && row.dataset.paper !== paper) || (verdict && row.dataset.verdict !== verdict)
        || !words.every((word) => content.includes(word));
    }
    form.querySelector("output").textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length}`;
  };
  const read = () => {
    if (location.hash && !location.hash.includes("=")) return; // the address of one value
    const chosen = new URLSearchParams(location.hash.slice(1));
    for (const field of form.elements) if (field.name) field.value = chosen.get(field.name) ?? "";
    show();
  };
  form.hidden = false;
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("input", () => {
    const chosen = [...new FormData(form)].filter(([, value]) => value);
    history.replaceState(null, "", "#" + new URLSearchParams(chosen));
    show();
  });
  addEventListener("hashchange", read);
  show();
  read();
}
