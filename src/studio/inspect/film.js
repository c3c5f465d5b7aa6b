// Play and pause by the button or the space bar, steps by the arrows or the slider. `film` is a list of seconds and pictures.

const by = (id) => document.getElementById(id);
let at = 0, since = 0, playing = false;
function show(k) {
  at = Math.min(Math.max(k, 0), film.length - 1);
  by("film").src = "data:image/jpeg;base64," + film[at][1];
  by("at").value = at;
  by("when").textContent = film[at][0].toFixed(2) + " s";
}
function tick(now) {
  if (!playing) return;
  const due = film[at][0] + (now - since) / 1000;
  let k = at;
  while (k + 1 < film.length && film[k + 1][0] <= due) k += 1;
  if (k !== at) {
    since += (film[k][0] - film[at][0]) * 1000;
    show(k);
  }
  if (k + 1 < film.length) requestAnimationFrame(tick); else play(false);
}
function play(on) {
  playing = on;
  by("play").textContent = on ? "Pause" : "Play";
  if (!on) return;
  if (at === film.length - 1) show(0);
  since = performance.now();
  requestAnimationFrame(tick);
}
by("play").onclick = () => play(!playing);
by("at").oninput = () => { play(false); show(Number(by("at").value)); };
addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (event.key === " ") play(!playing);
  else if (step) { play(false); show(at + step); }
  else return;
  event.preventDefault();
});
show(0);
