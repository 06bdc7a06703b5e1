// The page's side of the picture in a notebook: shows frames, and sends what the mouse does. widget.py answers, and
// puts browser/picture.js before this.

function render({ model, el }) {
  // An answer names the page that asked, since every view of the widget gets it.
  const page = Math.random().toString(36);
  const canvas = document.createElement("canvas");
  canvas.style.cssText = "display: block; max-width: 100%";
  const note = document.createElement("pre");
  note.style.cssText = "white-space: pre-wrap; margin: 0";
  note.textContent = "rendering the first frame";
  el.append(canvas, note);

  let wanted = false; // whether to ask again after the answer that is on its way
  let waiting = false;
  let closed = false;

  const ask = () => {
    wanted = true;
    if (waiting || closed) return;
    model.send({ page, ...pointer.take() });
    [wanted, waiting] = [false, true];
  };
  const pointer = watch(canvas, ask);

  const show = async (answer, buffers) => {
    if (answer.refresh) return ask();
    note.textContent = answer.error ?? "";
    if (!answer.error) await draw(canvas, buffers, answer.type);
    if (answer.page !== page) return;
    waiting = false;
    if (wanted || !(answer.finished || answer.error)) ask();
  };

  model.on("msg:custom", show);
  ask();
  return () => {
    closed = true;
    model.off("msg:custom", show);
  };
}

export default { render };
