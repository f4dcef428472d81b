// The page begins: the theme, the index, the views in their order, and the head that says where one is.
"use strict";

(() => {
  const { all, one, themes } = shared;
  const main = one("#view");

  // Marks the view in the head. A reader's place moves to the heading of a view that was not there before.
  function arrive(moved) {
    const { view } = document.documentElement.dataset;
    for (const link of all(".top nav a")) {
      if (link.getAttribute("href") === `#/${view}`) link.setAttribute("aria-current", "page");
      else link.removeAttribute("aria-current");
    }
    const heading = one("h1", main);
    if (!moved) return;
    if (view !== "explore") scrollTo({ top: 0, behavior: "instant" }); // explore goes back to where it was
    if (heading) heading.focus({ preventScroll: true });
  }

  function follow() {
    let before = document.documentElement.dataset.view;
    arrive(false);
    addEventListener("hashchange", () => {
      const now = document.documentElement.dataset.view;
      arrive(now !== before);
      before = now;
    });
  }

  function failed(error) {
    main.replaceChildren(
      elements.make("p.alone", { role: "alert" }, `The list of objects cannot be shown. ${error.message}.`),
    );
  }

  // The link to skip the head would be taken for a view.
  one(".skip").addEventListener("click", (event) => {
    event.preventDefault();
    main.focus();
  });
  addEventListener("keydown", (event) => {
    const find = one("input[type=search]", main);
    if (event.key !== "/" || !find || /INPUT|SELECT|TEXTAREA/.test(document.activeElement.tagName)) return;
    event.preventDefault();
    find.focus();
  });
  themes();
  vibraverse.loadIndex().then((data) => {
    const shelf = catalogue.read(data, vibraverse.taken());
    const views = { overview, explore, run };
    for (const [name, made] of Object.entries(views)) route.add(name, made.view(shelf));
    route.start(data.kind === "dataset" ? "explore" : "overview");
    follow();
  }, failed);
})();
