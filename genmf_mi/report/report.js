// The 3D view in the report: takes the mesh out of the page and connects the controls.
import { Viewer } from "./viewer.js";
import { unpack } from "./packed.js";

const place = document.getElementById("viewer"), message = document.getElementById("viewer-message");
const WHY = {
  "no-webgl": "The 3D view needs WebGL 2, which this browser does not offer or has switched off.",
  "context-lost": "The graphics driver stopped the 3D view. Reload the page to see it again.",
  refused: "The graphics driver refused the 3D view.",
};
const fail = (why) => {
  place.classList.add("failed");
  place.querySelector(".controls").hidden = true;
  message.textContent = why + " The pictures below show the same shapes; the mesh files open in any slicer or 3D viewer.";
};

async function show() {
  const meta = JSON.parse(document.getElementById("mesh-meta").textContent);
  const viewer = new Viewer(place.querySelector("canvas"), meta, { onFail: (code) => fail(WHY[code]) });
  if (!viewer.ok) return;
  if (typeof DecompressionStream === "undefined") return fail("The 3D view needs a newer browser (2023 or later).");
  try {
    viewer.setMesh(await unpack(meta, document.getElementById("mesh-data").textContent));
  } catch (error) {
    return fail("The 3D view could not be unpacked (" + error.message + ").");
  }
  place.addEventListener("input", ({ target }) => {
    if (target.name === "shape") viewer.morph(Number(target.value));
    if (target.name === "lamp") viewer.set({ lamp: Number(target.value) });
    if (target.name === "surface") {
      viewer.set({ surface: Number(target.value) });
      document.getElementById("viewer-legend").hidden = target.value !== "2";
    }
  });
  const actions = { in: () => viewer.zoom(1.25), out: () => viewer.zoom(0.8), reset: () => viewer.reset() };
  place.addEventListener("click", ({ target }) => actions[target.dataset.action]?.());
  place.querySelector(".controls").hidden = false;
  message.textContent = "";
}

show();
