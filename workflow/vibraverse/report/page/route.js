// The address after "#": a view, what it shows, and its settings, as in #/object/bowl?material=glass. A view is an
// object {show(root, route), change(route), leave()}; it gets `show` when it comes, `change` when only its settings do.
"use strict";

const route = (() => {
  const views = {};
  let first = ""; // the view that is shown where the address names none
  let current = null;

  function parse(hash) {
    const [path, query = ""] = hash.replace(/^#\/?/, "").split("?", 2);
    const [view, ...rest] = path.split("/");
    let subject;
    try {
      subject = decodeURIComponent(rest.join("/"));
    } catch {
      subject = rest.join("/"); // an address that somebody cut in the middle
    }
    return { view: view || first, subject, settings: new URLSearchParams(query) };
  }

  function format({ view, subject = "", settings }) {
    const query = String(settings || "");
    return `#/${view}${subject && `/${encodeURIComponent(subject)}`}${query && `?${query}`}`;
  }

  function follow() {
    const asked = parse(location.hash);
    if (!views[asked.view]) asked.view = first;
    const view = views[asked.view];
    if (current && current.view === asked.view && current.subject === asked.subject) {
      current = asked;
      if (view.change) view.change(asked);
      return;
    }
    if (current && views[current.view].leave) views[current.view].leave();
    current = asked;
    const root = document.querySelector("#view");
    root.replaceChildren();
    document.documentElement.dataset.view = asked.view;
    view.show(root, asked);
  }

  return {
    parse,
    format,
    add(name, view) {
      views[name] = view;
    },
    // Shows what the address names, or the view of this name; without one, the view that was added first.
    start(name) {
      first = name || Object.keys(views)[0];
      addEventListener("hashchange", follow);
      follow();
    },
    go(to) {
      location.hash = format(to);
    },
    // Writes settings into the address, with no new entry in the history and no call of `change`.
    settle(settings) {
      current.settings = settings;
      try {
        history.replaceState(null, "", format(current));
      } catch {
        // some browsers forbid this for pages from disk, or too often: the link is then the last one that was written
      }
    },
  };
})();

if (typeof module !== "undefined") module.exports = route;
