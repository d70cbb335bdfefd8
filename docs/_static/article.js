// One switch for all code of a notebook's page.
const codes = [...document.querySelectorAll("details.code")];
const top_ = document.querySelector("p.top");
if (codes.length && top_) {
  const button = document.createElement("button");
  const say = () => { button.textContent = codes.some((each) => !each.open) ? "Show all code" : "Hide all code"; };
  button.type = "button";
  button.addEventListener("click", () => {
    const open = codes.some((each) => !each.open);
    for (const each of codes) each.open = open;
    say();
  });
  for (const each of codes) each.addEventListener("toggle", say);
  say();
  top_.prepend(button);
}
