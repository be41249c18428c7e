// Wheel, drag and pinch on a canvas.

const WHEEL_RATE = 0.0015;

const STEADY = 5;

/** Calls `onPan(dx, dy)`, `onZoom(factor, point)`, `onPoint(point or null)`; lengths in CSS pixels. */
export function listenToGestures(canvas, { onPan, onZoom, onPoint }) {
  const pointers = new Map();
  const place = ({ clientX, clientY }) => {
    const { left, top } = canvas.getBoundingClientRect();
    return [clientX - left, clientY - top];
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { at: place(event), from: place(event), isDragging: pointers.size > 0 });
    onPoint(place(event));
  });
  canvas.addEventListener("pointermove", (event) => {
    const pointer = pointers.get(event.pointerId);
    if (!pointer) onPoint(place(event));
    else if (isDragged(pointer, place(event))) {
      const before = placesOf(pointers);
      pointer.at = place(event);
      onPoint(null);
      drag(before, placesOf(pointers), onPan, onZoom);
    }
  });
  for (const ending of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(ending, (event) => pointers.delete(event.pointerId));
  }
  canvas.addEventListener("pointerleave", (event) => event.pointerType === "mouse" && onPoint(null));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    onZoom(Math.exp(-WHEEL_RATE * event.deltaY), place(event));
  });
}

const placesOf = (pointers) => [...pointers.values()].map(({ at }) => at);

/** Whether a pointer has left where it came down: a tap is not quite steady. */
function isDragged(pointer, at) {
  pointer.isDragging ||= spread([pointer.from, at]) > STEADY;
  return pointer.isDragging;
}

/** One finger pans, two pan and zoom. */
function drag(before, after, onPan, onZoom) {
  const [from, to] = [middle(before), middle(after)];
  onPan(to[0] - from[0], to[1] - from[1]);
  if (after.length > 1) onZoom(spread(after) / Math.max(spread(before), 1), to);
}

const middle = (points) => [0, 1].map((axis) => points.reduce((sum, point) => sum + point[axis], 0) / points.length);

const spread = ([one, other]) => Math.hypot(one[0] - other[0], one[1] - other[1]);
