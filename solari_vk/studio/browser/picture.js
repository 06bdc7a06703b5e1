// A picture in a page that the pointer moves: shared by the notebook's widget and the page of `solari-vk serve`.

const CLICK = 4; // pixels: a button that is released nearer is a click, not a drag

const still = () => ({ right: 0, down: 0, pan_right: 0, pan_down: 0, notches: 0, home: false });

// Watches a canvas. `moved` is called after each movement, and `take` returns the movements since its last call: orbits
// in pixels, pans in shares of the canvas's height, zooms in notches of a wheel. hear: {grab, click}, called with the
// place in the canvas, from 0 to 1, where a drag begins and where a click was.
function watch(canvas, moved, hear = {}) {
  const fingers = new Map(); // where each pointer that is down was last
  let movement = still();
  let began = null; // the first pointer's event, until it is a drag
  let pans = false;
  canvas.style.touchAction = "none";
  canvas.style.cursor = "grab";

  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  };
  const move = (right, down, as_pan) => {
    const height = canvas.getBoundingClientRect().height;
    if (as_pan) [movement.pan_right, movement.pan_down] = [movement.pan_right + right / height, movement.pan_down + down / height];
    else [movement.right, movement.down] = [movement.right + right, movement.down + down];
    moved();
  };
  const zoom = (notches) => {
    movement.notches += notches;
    moved();
  };
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
  };

  canvas.addEventListener("pointerdown", (event) => {
    fingers.set(event.pointerId, event);
    canvas.setPointerCapture(event.pointerId);
    canvas.style.cursor = "grabbing";
    began = fingers.size === 1 ? event : null;
    pans = event.button !== 0 || event.shiftKey || fingers.size > 1;
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    if (began) {
      if (Math.hypot(event.clientX - began.clientX, event.clientY - began.clientY) < CLICK) return;
      if (!pans) hear.grab?.(...place(began));
      began = null;
    }
    const width = fingers.size === 2 ? spread() : 0;
    fingers.set(event.pointerId, event);
    move((event.clientX - before.clientX) / fingers.size, (event.clientY - before.clientY) / fingers.size, pans);
    if (width) zoom(4 * Math.log(spread() / width));
  });
  canvas.addEventListener("pointerup", () => {
    if (began && !pans) hear.click?.(...place(began));
  });
  canvas.addEventListener("lostpointercapture", (event) => {
    fingers.delete(event.pointerId);
    began = null;
    if (!fingers.size) canvas.style.cursor = "grab";
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault()); // the right button pans
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault(); // the page must not scroll
    zoom(-event.deltaY / (event.deltaMode === WheelEvent.DOM_DELTA_PIXEL ? 100 : 3));
  }, { passive: false });
  const home = () => {
    movement = { ...still(), home: true };
    moved();
  };
  canvas.addEventListener("dblclick", home);

  return {
    home,
    take: () => {
      const taken = movement;
      movement = still();
      return taken;
    },
  };
}

// Draws an encoded picture, whose size the canvas takes.
async function draw(canvas, content, type) {
  const picture = await createImageBitmap(new Blob(content, { type }));
  if (canvas.width !== picture.width || canvas.height !== picture.height)
    [canvas.width, canvas.height] = [picture.width, picture.height];
  canvas.getContext("2d").drawImage(picture, 0, 0);
  picture.close();
}

export { draw, watch };
