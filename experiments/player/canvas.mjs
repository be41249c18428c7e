// Canvases that are as sharp as the screen, and what is drawn on them.

/** Give a canvas as many pixels as it fills on the screen; returns its context, in CSS pixels, and its size. */
export function prepare(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const { width, height } = canvas.getBoundingClientRect();
  const pixels = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== pixels[0] || canvas.height !== pixels[1]) [canvas.width, canvas.height] = pixels;
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

/** Append a line of points [x, y] to a path. */
export function trace(path, points) {
  points.forEach(([x, y], place) => (place ? path.lineTo(x, y) : path.moveTo(x, y)));
  return path;
}

/** The path of rings of points, each closed. */
export function ringsPath(rings) {
  const path = new Path2D();
  for (const ring of rings) trace(path, ring).closePath();
  return path;
}

/** The path of lines of points. */
export function linesPath(lines) {
  const path = new Path2D();
  for (const line of lines) trace(path, line);
  return path;
}

/** Draw a path's lines. */
export function stroke(context, path, color, width, { dash = [], alpha = 1 } = {}) {
  context.save();
  context.globalAlpha = alpha;
  context.strokeStyle = color;
  context.lineWidth = width;
  context.lineJoin = "round";
  context.setLineDash(dash);
  context.stroke(path);
  context.restore();
}

/** Fill a path; holes are inside an even number of its rings. */
export function fill(context, path, color, alpha = 1) {
  context.save();
  context.globalAlpha = alpha;
  context.fillStyle = color;
  context.fill(path, "evenodd");
  context.restore();
}
