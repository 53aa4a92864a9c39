// Mouse, fingers and keys on a 3D view. A tool of the view, if there is one, has the main button and single fingers.

/** Let a viewer be turned, shifted and zoomed, and hand what belongs to its tool to it. */
export function listen(viewer) {
  const { canvas } = viewer, pointers = new Map();
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    if (!viewer.mesh) return;
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (pointers.size > 1) viewer.tool?.cancel();
    else if (viewer.tool && event.button === 0 && !event.shiftKey) viewer.tool.down(event);
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = pointers.get(event.pointerId);
    if (!last) return viewer.tool?.hover(event);
    const now = [event.clientX, event.clientY], dx = now[0] - last[0], dy = now[1] - last[1];
    const other = [...pointers].find(([id]) => id !== event.pointerId);
    pointers.set(event.pointerId, now);
    if (other) {
      const gap = (p) => Math.hypot(p[0] - other[1][0], p[1] - other[1][1]) || 1;
      viewer.zoom(gap(now) / gap(last));
      if (viewer.tool) viewer.orbit(dx / 2, dy / 2); else viewer.shift(dx / 2, dy / 2);
    } else if (viewer.tool?.active) viewer.tool.move(event);
    else if (viewer.tool && event.buttons & 2) viewer.orbit(dx, dy);
    else if (event.buttons & 2 || event.shiftKey) viewer.shift(dx, dy);
    else viewer.orbit(dx, dy);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => { pointers.delete(event.pointerId); viewer.tool?.up(event); });
  canvas.addEventListener("pointerleave", () => viewer.tool?.leave());
  // Two fingers belong to the view; one finger that moves up or down scrolls the page (touch-action: pan-y)
  canvas.addEventListener("touchmove", (event) => { if (event.touches.length > 1) event.preventDefault(); }, { passive: false });
  canvas.addEventListener("wheel", (event) => {
    if (!viewer.mesh || (!viewer.options.eager && document.activeElement !== canvas && !event.ctrlKey)) return;
    event.preventDefault();
    viewer.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)));
  }, { passive: false });
  const keys = {
    ArrowLeft: () => viewer.orbit(-15, 0), ArrowRight: () => viewer.orbit(15, 0), ArrowUp: () => viewer.orbit(0, 15), ArrowDown: () => viewer.orbit(0, -15),
    "+": () => viewer.zoom(1.2), "=": () => viewer.zoom(1.2), "-": () => viewer.zoom(1 / 1.2), 0: () => viewer.reset(),
  };
  canvas.addEventListener("keydown", (event) => {
    if (!viewer.mesh || !keys[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    keys[event.key]();
  });
}
