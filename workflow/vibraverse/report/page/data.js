// What the page has read. Data come as scripts that call vibraverse.index, vibraverse.object and vibraverse.body,
// because a page that is opened from disk may read no files but scripts. Data of one HTML file are there before they
// are asked for.
"use strict";

const vibraverse = (() => {
  const arrived = new Map(); // what the scripts have brought, by name
  const asked = new Map(); // promises, by name
  const named = (...parts) => parts.join("/");

  function load(name, file) {
    if (!asked.has(name)) {
      const promise = new Promise((resolve, reject) => {
        if (arrived.has(name)) {
          resolve(arrived.get(name));
          return;
        }
        const script = document.createElement("script");
        script.src = file;
        script.onload = () => {
          script.remove();
          if (arrived.has(name)) resolve(arrived.get(name));
          else reject(new Error(`${file} is damaged: make the page again`));
        };
        script.onerror = () => {
          script.remove();
          reject(new Error(`${file} is missing: copy the whole folder of the page, or make it again`));
        };
        document.head.append(script);
      });
      promise.catch(() => asked.delete(name)); // so that a later try asks again
      asked.set(name, promise);
    }
    return asked.get(name);
  }

  // A file of the page itself. Its folder is named by a hash of what it holds, and the shell names the folder.
  const own = (name) => `${document.documentElement.dataset.page || "page"}/${name}`;
  // A file of an object; `version` is the hash of the object's data, so that no browser shows old ones.
  const file = (stem, version) => `data/objects/${encodeURIComponent(stem)}.js${version ? `?${version}` : ""}`;

  return {
    index: (data) => arrived.set("index", data),
    times: (data) => arrived.set("times", data),
    object: (id, data) => arrived.set(named("object", id), data),
    body: (id, solidity, data) => arrived.set(named("body", id, solidity), data),
    own,
    taken: () => arrived.get("times"), // undefined where the run's times are not there
    loadIndex: () => load("index", own("index.js")),
    loadObject: (id, version) => load(named("object", id), file(id, version)),
    loadBody: (id, solidity, version) => load(named("body", id, solidity), file(`${id}.${solidity}`, version)),
  };
})();
