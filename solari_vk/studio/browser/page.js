// The page of `solari-vk serve`: shows frames and figures, and sends what the user does. hub.py answers.

import { draw, watch } from "./picture.js";

const RETRY = 1000; // milliseconds between two attempts to connect
const SPAN = 2000; // milliseconds over which frames and bytes are counted
const TITLES = { realtime: "Realtime", reference: "Reference", split: "Split" };
const HINTS = {
  realtime: "One path a pixel, gathered over frames",
  reference: "Realtime while the camera moves, then the path tracer: the truth",
  split: "Realtime beside the path tracer",
};
const element = (id) => document.getElementById(id);
const canvas = element("picture");

// ---- the connection: what a reload goes on from is kept in the tab -----------------------------------

const session = sessionStorage.session ?? (sessionStorage.session = crypto.getRandomValues(new Uint32Array(4)).join("-"));
element("download").href = `picture.png?session=${session}`;
let line = null;
let input = 0; // the number of the last movement that was sent
const sentAt = new Map(); // when each movement was sent, until a frame shows it
let resume = null; // tells the server that the last frame was shown, once the page is visible again
let ended = false;

const send = (message) => {
  if (line?.readyState !== WebSocket.OPEN) return;
  line.send(JSON.stringify(message));
};
const wanted_width = () => Math.ceil(canvas.getBoundingClientRect().width * devicePixelRatio);

function connect() {
  line = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  line.binaryType = "arraybuffer";
  line.onopen = () => {
    const state = sessionStorage.state ? JSON.parse(sessionStorage.state) : null;
    send({ session, state, width: wanted_width() });
  };
  line.onmessage = ({ data }) => (typeof data === "string" ? hear(JSON.parse(data)) : show(data));
  line.onclose = () => {
    sentAt.clear();
    element("state").className = "dot lost";
    if (ended) return;
    say("no connection to the server: trying again", true);
    setTimeout(connect, RETRY);
  };
}

function hear(message) {
  if (message.about) describe(message.about);
  if (message.options) follow(message.options);
  if (message.note) say(message.note);
  if ("picked" in message) name_picked(message.picked);
  if (message.error) {
    element("error").textContent = message.error;
    element("error").hidden = false;
    ended ||= message.final;
  }
}

function say(text, waits = false) {
  element("note").textContent = text;
  element("note").hidden = !text;
  element("frame").classList.toggle("waits", waits);
}

// ---- frames ----------------------------------------------------------------------------------------

const counted = []; // [time, bytes] of the latest frames

async function show(data) {
  const length = new DataView(data).getUint32(0, true);
  const about = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  await draw(canvas, [new Uint8Array(data, 4 + length)], about.type);
  const shown = () => send({ shown: about.frame });
  if (document.hidden) resume = shown; // a page that nobody sees asks for nothing
  else shown();
  const now = performance.now();
  counted.push([now, data.byteLength]);
  element("note").classList.toggle("small", Boolean(about.preview));
  if (about.preview) return;
  say("");
  element("error").hidden = true;
  sessionStorage.state = JSON.stringify(about.state);
  follow(about.state.options);
  for (const [number, time] of sentAt) {
    if (number > about.input) break;
    sentAt.delete(number);
    if (number === about.input) element("latency").textContent = Math.round(now - time);
  }
  lay_out(about);
  const [width, height] = about.rendered;
  element("pixels").textContent = `${width}×${height} → ${canvas.width}×${canvas.height}`;
  element("state").className = about.finished ? "dot done" : "dot live";
  const refines = about.samples ? `${about.samples} samples` : about.done ? "refining" : "rendering";
  const state = about.finished ? "finished" : `${refines}, ${Math.round(1000 * about.seconds)} ms a frame`;
  element("progress").textContent = state;
  element("done").style.width = `${100 * about.done}%`;
}

setInterval(() => {
  const since = performance.now() - SPAN;
  while (counted.length && counted[0][0] < since) counted.shift();
  const fps = (1000 * counted.length) / SPAN;
  element("fps").textContent = fps.toFixed(fps < 10 ? 1 : 0);
  element("rate").textContent = Math.round(counted.reduce((sum, [, bytes]) => sum + bytes, 0) / SPAN);
}, 250);

document.addEventListener("visibilitychange", () => {
  if (document.hidden || !resume) return;
  resume();
  resume = null;
});

// ---- the pointer and the keys ----------------------------------------------------------------------

let pending = false; // one message a frame of the browser is enough
const pointer = watch(canvas, () => {
  element("picked").hidden = true;
  if (pending) return;
  pending = true;
  requestAnimationFrame(() => {
    pending = false;
    sentAt.set(++input, performance.now());
    send({ move: pointer.take(), input });
  });
}, {
  grab: (x, y) => send({ grab: [x, y] }),
  click: (x, y) => {
    place(element("picked"), x, y);
    send({ pick: [x, y] });
  },
});
element("home").onclick = pointer.home;
const toggle = () => {
  const hidden = (element("panel").hidden = !element("panel").hidden);
  element("toggle").setAttribute("aria-expanded", String(!hidden));
};
element("toggle").onclick = toggle;
addEventListener("keydown", (event) => {
  if (event.target.matches("input, select") || event.ctrlKey || event.metaKey || event.altKey) return;
  const action = { r: pointer.home, t: toggle, s: () => element("download").click() }[event.key.toLowerCase()];
  if (action) action();
});
new ResizeObserver(() => {
  send({ width: wanted_width() });
  if (latest) lay_out(latest);
}).observe(canvas);

function place(item, x, y) {
  const box = canvas.getBoundingClientRect(), frame = element("frame").getBoundingClientRect();
  item.style.left = `${box.left - frame.left + x * box.width}px`;
  item.style.top = `${box.top - frame.top + y * box.height}px`;
}

function name_picked(picked) {
  const item = element("picked");
  item.hidden = false;
  item.textContent = picked ? picked.name : "nothing there";
  if (!picked) return;
  const more = document.createElement("small");
  more.textContent = [picked.material, picked.point.map((x) => x.toFixed(2)).join(", ") + " m"].filter(Boolean).join(" · ");
  item.append(more);
}

// ---- the split view --------------------------------------------------------------------------------

let latest = null;
let drags = false;

function lay_out(about) {
  latest = about;
  const columns = Object.entries(about.columns), splits = columns.length > 1;
  const height = `${canvas.getBoundingClientRect().height}px`;
  element("labels").replaceChildren();
  for (const [name, [begin, end]] of splits ? columns.filter(([, [begin, end]]) => end > begin) : []) {
    const label = document.createElement("span"), border = document.createElement("i");
    label.textContent = name;
    place(label, (begin + end) / 2, 0);
    label.style.top = `calc(${label.style.top} + 0.6rem)`;
    place(border, begin, 0);
    border.style.height = height;
    element("labels").append(label, ...(begin > 0 ? [border] : []));
  }
  const divider = element("divider");
  divider.hidden = !splits;
  if (!splits) return;
  if (!drags) move_divider(about.state.options.divider);
  divider.style.height = height;
}

function move_divider(share) {
  place(element("divider"), share, 0);
  element("divider").setAttribute("aria-valuenow", Math.round(100 * share));
}
const set_divider = (share) => {
  const divider = Math.min(Math.max(share, 0), 1);
  move_divider(divider);
  send({ set: { divider } });
};
element("divider").addEventListener("pointerdown", (event) => {
  drags = true;
  event.target.setPointerCapture(event.pointerId);
});
element("divider").addEventListener("pointermove", (event) => {
  const box = canvas.getBoundingClientRect();
  if (drags) set_divider((event.clientX - box.left) / box.width);
});
element("divider").addEventListener("lostpointercapture", () => (drags = false));
element("divider").addEventListener("keydown", (event) => {
  const step = { ArrowLeft: -0.02, ArrowRight: 0.02 }[event.key];
  if (step && latest) set_divider(latest.state.options.divider + step);
});

// ---- options ---------------------------------------------------------------------------------------

const fields = new Map(); // the settings: name -> {about, label, control}

const set = (name, value) => {
  element("error").hidden = true;
  send({ set: { [name]: value } });
};

function describe(about) {
  canvas.style.setProperty("--aspect", about.size[0] / about.size[1]);
  element("name").textContent = about.name.split("/").pop();
  element("device").textContent = about.device;
  document.title = `${element("name").textContent} - solari_vk`;
  const legend = element("modes").querySelector("legend");
  element("modes").replaceChildren(legend, ...about.modes.map((mode) => {
    const label = document.createElement("label"), button = document.createElement("input");
    Object.assign(button, { type: "radio", name: "mode", value: mode, onchange: () => set("mode", mode) });
    label.title = HINTS[mode];
    label.append(button, TITLES[mode]);
    return label;
  }));
  fill(element("tonemap"), about.tonemaps);
  fill(element("view"), Object.keys(about.views), about.views);
  fill(element("quality"), ["", ...about.qualities]);
  element("quality").options[0].textContent = "choose a preset";
  for (const name of ["tonemap", "view", "quality"])
    element(name).onchange = (event) => event.target.value && set(name, event.target.value);
  element("ev100").oninput = (event) => set("ev100", Number(event.target.value));
  list_settings(about.settings);
}

function fill(select, names, titles = {}) {
  select.replaceChildren(...names.map((name) => {
    const option = new Option(name.replaceAll("_", " "), name);
    option.title = titles[name] ?? "";
    return option;
  }));
}

function list_settings(settings) {
  const list = element("settings");
  list.replaceChildren();
  let section = "";
  for (const about of settings) {
    if (about.section !== section) {
      const title = document.createElement("h2");
      title.textContent = section = about.section;
      list.append(title);
    }
    const label = document.createElement("label"), words = document.createElement("span");
    words.textContent = about.name.replaceAll("_", " ");
    label.title = `${about.meaning}\nDefault: ${about.default}`;
    const control = document.createElement(about.choices.length ? "select" : "input");
    if (about.choices.length) fill(control, about.choices);
    else control.type = typeof about.default === "boolean" ? "checkbox" : "text";
    control.onchange = () => set(about.name, control.type === "checkbox" ? control.checked : control.value);
    label.append(words, control);
    list.append(label);
    fields.set(about.name, { about, label, control });
  }
}

element("search").oninput = (event) => {
  const word = event.target.value.toLowerCase().replaceAll(" ", "_");
  for (const { about, label } of fields.values())
    label.hidden = !`${about.name} ${about.meaning.toLowerCase().replaceAll(" ", "_")}`.includes(word);
};

// Shows options as the server has them, but for what the user is at.
function follow(options) {
  element("panel").classList.remove("unknown"); // until now its controls knew no state
  const busy = document.activeElement;
  for (const button of element("modes").querySelectorAll("input")) button.checked = button.value === options.mode;
  for (const name of ["tonemap", "view", "ev100"]) if (element(name) !== busy) element(name).value = options[name];
  element("ev100_value").textContent = `EV ${options.ev100.toFixed(1)}`;
  const changed = Object.keys(options.settings).length;
  element("changed").textContent = changed ? `${changed} changed` : "";
  for (const [name, { about, label, control }] of fields) {
    const value = options.settings[name] ?? about.default;
    label.classList.toggle("changed", name in options.settings);
    if (control === busy && control.type !== "checkbox") continue;
    if (control.type === "checkbox") control.checked = value;
    else control.value = String(value);
  }
}

connect();
