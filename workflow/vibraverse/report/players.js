/* Players of sounds: one sounds at a time; its cursor runs over the spectrogram. */
"use strict";
const players = (() => {
  const { one } = shared;
  const clamp = (value, low, high) => Math.min(high, Math.max(low, value));
  let current = null;
  function player(element) {
    const audio = one("audio", element);
    const track = one(".track", element);
    const button = one(".play", element);
    const label = button.getAttribute("aria-label");
    const duration = Number(element.dataset.duration);
    const show = (time) => {
      element.style.setProperty("--at", `${(100 * time) / duration}%`);
      track.setAttribute("aria-valuenow", time.toFixed(2));
      track.setAttribute("aria-valuetext", `${time.toFixed(2)} s`);
    };
    const follow = () => {
      show(audio.currentTime);
      if (!audio.paused) requestAnimationFrame(follow);
    };
    const seek = (time) => {
      element.classList.add("started");
      audio.currentTime = clamp(time, 0, duration);
      show(audio.currentTime);
    };
    const play = () => {
      if (current && current !== audio) current.pause();
      current = audio;
      return audio.play().catch(() => {});
    };
    const toggle = () => (audio.paused ? play() : audio.pause());
    audio.addEventListener("play", () => {
      element.classList.add("playing", "started");
      button.setAttribute("aria-label", label.replace("Play", "Pause"));
      follow();
    });
    audio.addEventListener("pause", () => {
      element.classList.remove("playing");
      button.setAttribute("aria-label", label);
    });
    audio.addEventListener("ended", () => {
      element.classList.remove("started");
      show(0);
    });
    button.addEventListener("click", toggle);
    track.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      const box = track.getBoundingClientRect();
      seek((duration * (event.clientX - box.left)) / box.width);
      if (audio.paused) play();
    });
    const keys = {
      ArrowLeft: () => seek(audio.currentTime - duration / 20),
      ArrowRight: () => seek(audio.currentTime + duration / 20),
      Home: () => seek(0),
      End: () => seek(duration),
      " ": toggle,
      Enter: toggle,
    };
    track.addEventListener("keydown", (event) => {
      if (!keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
  }
  const pauseHidden = () => {
    if (current && current.closest("[hidden]")) current.pause();
  };

  return { player, pauseHidden };
})();
