// Playing samples. Browsers allow sound in a gesture of the user only, so `unlock` is called in the first one.
"use strict";

const sound = (() => {
  const MOST = 8; // voices at once
  const FADE_S = 0.02;
  let context = null;
  let failed = false;
  let voices = [];

  // Creates or wakes the audio; returns whether there is any.
  function unlock() {
    const Context = window.AudioContext || window.webkitAudioContext;
    if (!context && !failed) {
      try {
        if (navigator.audioSession) navigator.audioSession.type = "playback";
        context = new Context({ latencyHint: "interactive" });
      } catch {
        failed = true; // no such thing here, or no device
      }
    }
    if (context && context.state === "suspended") context.resume().catch(() => {});
    return Boolean(context);
  }

  // Plays samples (float32 or float64, times a gain in decibels); returns {stop(), time()}: the seconds since it began.
  // Without audio nothing sounds, and the handle is null.
  function play({ samples, rate, gain_db = 0 }) {
    if (!unlock() || !samples.length) return null;
    const factor = 10 ** (gain_db / 20);
    const buffer = context.createBuffer(1, samples.length, rate);
    const channel = buffer.getChannelData(0);
    for (let place = 0; place < samples.length; place += 1) channel[place] = factor * samples[place];
    const source = context.createBufferSource();
    const level = context.createGain();
    source.buffer = buffer;
    source.connect(level).connect(context.destination);
    const started = context.currentTime;
    const voice = {
      stop() {
        level.gain.setTargetAtTime(0, context.currentTime, FADE_S / 4);
        source.stop(context.currentTime + FADE_S);
      },
      time: () => context.currentTime - started,
    };
    source.onended = () => {
      voices = voices.filter((one) => one !== voice);
    };
    while (voices.length >= MOST) voices.shift().stop();
    voices.push(voice);
    source.start();
    return voice;
  }

  function hush() {
    voices.forEach((one) => one.stop());
    voices = [];
  }

  return { unlock, play, hush };
})();
