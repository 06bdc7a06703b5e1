// The page's side of the picture in a notebook: shows frames, and sends what the mouse does. widget.py answers.

const still = () => ({ right: 0, down: 0, notches: 0, home: false });

function render({ model, el }) {
  // An answer names the page that asked, since every view of the widget gets it.
  const page = Math.random().toString(36);
  const canvas = document.createElement("canvas");
  canvas.style.cssText = "display: block; max-width: 100%; touch-action: none; cursor: grab";
  const note = document.createElement("pre");
  note.style.cssText = "white-space: pre-wrap; margin: 0";
  note.textContent = "rendering the first frame";
  el.append(canvas, note);

  let moved = still();
  let wanted = false; // whether to ask again after the answer that is on its way
  let waiting = false;
  let closed = false;

  const ask = () => {
    wanted = true;
    if (waiting || closed) return;
    model.send({ page, ...moved });
    [moved, wanted, waiting] = [still(), false, true];
  };

  const show = async (answer, buffers) => {
    if (answer.refresh) return ask();
    note.textContent = answer.error ?? "";
    if (!answer.error) {
      const picture = await createImageBitmap(new Blob(buffers, { type: answer.type }));
      if (canvas.width !== picture.width || canvas.height !== picture.height)
        [canvas.width, canvas.height] = [picture.width, picture.height];
      canvas.getContext("2d").drawImage(picture, 0, 0);
      picture.close();
    }
    if (answer.page !== page) return;
    waiting = false;
    if (wanted || !(answer.settled || answer.error)) ask();
  };

  let cursor = { clientX: 0, clientY: 0 }; // where a drag has come to
  canvas.addEventListener("pointerdown", (event) => {
    cursor = event;
    canvas.setPointerCapture(event.pointerId);
    canvas.style.cursor = "grabbing";
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!canvas.hasPointerCapture(event.pointerId)) return;
    moved.right += event.clientX - cursor.clientX;
    moved.down += event.clientY - cursor.clientY;
    cursor = event;
    ask();
  });
  canvas.addEventListener("lostpointercapture", () => (canvas.style.cursor = "grab"));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault(); // the page must not scroll
    moved.notches -= event.deltaY / (event.deltaMode === WheelEvent.DOM_DELTA_PIXEL ? 100 : 3);
    ask();
  }, { passive: false });
  canvas.addEventListener("dblclick", () => {
    moved = { ...still(), home: true };
    ask();
  });

  model.on("msg:custom", show);
  ask();
  return () => {
    closed = true;
    model.off("msg:custom", show);
  };
}

export default { render };
