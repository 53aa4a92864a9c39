// The page: which job is shown, the model, and what can be done with it.
import { ONE_COLOUR, PRINTED, RELIEF, TEXTURE, Viewer } from "/viewer.js";
import { ask, follow, upload } from "/api.js";
import { readGlb } from "/glb.js";
import { Paint } from "/painting.js";
import { Progress } from "/running.js";
import { Result } from "/result.js";
import { Settings, turnFor } from "/settings.js";
import { el, explain, language, loadTexts, number, plural, sentence, t, translate } from "/texts.js";
import { zip } from "/zip.js";

const $ = (id) => document.getElementById(id);
const state = { options: null, job: null, jobs: [], local: null, mesh: null, shown: null, stop: null, saving: null };
let viewer, settings, painting, progress, result;

async function begin() {
  await loadTexts();
  state.options = await ask("options");
  viewer = new Viewer($("canvas"), state.options.look, {
    eager: true, onFail: (code) => { $("view-message").textContent = t(`view.${code}`); }, onDraw: ruler,
  });
  settings = new Settings($("settings"), state.options, { onChange: () => { arrange(); save(); }, onTurn: turn });
  painting = new Paint($("painting"), viewer, save);
  progress = new Progress($("progress"));
  result = new Result($("result"), viewer);
  words();
  await refreshJobs();
  await open(location.hash.match(/^#job=([\w-]+)$/)?.[1] ?? null);
  connect();
  takeChosen(); // a file that was chosen before the page could listen
  setInterval(refreshJobs, 3000);
}

function words() {
  translate();
  $("language").value = language;
  document.title = state.job ? `${state.job.name} – genmf` : t("title");
  settings.draw();
  painting.draw();
  render();
}

function takeChosen() {
  const files = [...$("file").files];
  $("file").value = "";
  if (files.length) take(files);
}

function connect() {
  $("language").addEventListener("change", async () => { await loadTexts($("language").value); words(); });
  $("home").addEventListener("click", () => open(null));
  $("choose").addEventListener("click", () => $("file").click());
  $("file").addEventListener("change", takeChosen);
  $("sample").addEventListener("click", sample);
  $("lamp").addEventListener("input", () => viewer.set({ lamp: Number($("lamp").value) }));
  $("split").addEventListener("input", () => viewer.set({ split: Number($("split").value) / 1000 }));
  for (const button of document.querySelectorAll("[data-zoom]")) {
    button.addEventListener("click", () => ({ in: () => viewer.zoom(1.25), out: () => viewer.zoom(0.8), reset: () => viewer.reset() })[button.dataset.zoom]());
  }
  $("surfaces").addEventListener("change", arrange);
  $("shapes").addEventListener("change", arrange);
  window.addEventListener("hashchange", () => open(location.hash.match(/^#job=([\w-]+)$/)?.[1] ?? null));
  window.addEventListener("pagehide", () => { if (state.saving) save(true); });
  let depth = 0;
  const files = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
  document.addEventListener("dragenter", (event) => { if (files(event)) { depth++; document.body.classList.add("dragging"); event.preventDefault(); } });
  document.addEventListener("dragleave", () => { depth = Math.max(0, depth - 1); document.body.classList.toggle("dragging", depth > 0); });
  document.addEventListener("dragover", (event) => { if (files(event)) event.preventDefault(); });
  document.addEventListener("drop", (event) => {
    if (!files(event)) return;
    event.preventDefault();
    depth = 0;
    document.body.classList.remove("dragging");
    take([...event.dataTransfer.files]);
  });
  document.addEventListener("keydown", (event) => {
    if ((event.ctrlKey || event.metaKey) && event.key === "z" && state.job?.state === "ready" && !event.target.matches("input, select")) { event.preventDefault(); painting.undo(); }
  });
}

/** A model was dropped: show it if the page can read it, and send it. */
async function take(files) {
  if (!files.length) return;
  const single = files.length === 1 ? files[0] : null;
  const total = files.reduce((sum, file) => sum + file.size, 0);
  leave();
  fail("");
  if (total > state.options.max_bytes) return refuse(t("error.too-large"));
  state.local = null;
  if (single && /\.glb$/i.test(single.name)) {
    try {
      const mesh = await readGlb(await single.arrayBuffer());
      view("ready");
      show(mesh);
      state.local = { file: single, mesh };
      performance.mark("model-shown");
    } catch { /* the server reads it */ }
  }
  view("ready");
  if (!state.local) { viewer.mesh = null; viewer.gl?.clear(viewer.gl.COLOR_BUFFER_BIT); }
  for (const card of ["about", "settings", "painting", "progress", "result", "actions"]) $(card).hidden = true;
  $("view-message").textContent = t("drop.sending");
  try {
    const sent = single ?? await zip(files);
    const job = await upload(sent, single?.name ?? "files.zip", (share) => { $("view-message").textContent = `${t("drop.sending")} ${number(100 * share, 0)} %`; });
    if (state.local) state.local.job = job.id;
    await refreshJobs();
    location.hash = `job=${job.id}`;
  } catch (error) {
    refuse(error.code === "asset" ? sentence(error.message) : explain(error));
  }
}

async function sample() {
  $("sample").disabled = true;
  try {
    const job = await ask("samples/ladybug", { method: "POST" });
    await refreshJobs();
    location.hash = `job=${job.id}`;
  } catch (error) { refuse(explain(error)); }
  $("sample").disabled = false;
}

function refuse(words) {
  open(null);
  $("drop-error").textContent = words;
}

function fail(words) { $("error").textContent = words; $("drop-error").textContent = words; }
function view(name) { document.body.dataset.view = name; }
function leave() { state.stop?.(); state.stop = null; state.shown = null; }

/** Show a job, or the place to drop a model. */
async function open(id) {
  if (id && id === state.job?.id && state.stop) return;
  if (state.saving) await save(true);
  leave();
  fail("");
  state.job = null;
  $("view-message").textContent = "";
  if (!id) {
    if (location.hash) history.pushState(null, "", location.pathname);
    view("empty");
    document.title = t("title");
    return drawJobs();
  }
  try {
    const [job, draft] = await Promise.all([ask(`jobs/${id}`), ask(`jobs/${id}/draft`)]);
    settings.load(job.settings ?? draft.settings ?? {});
    painting.load(draft.regions, draft.turn);
    progress.reset();
    result.reset();
    state.job = job;
    view("ready");
    update(job);
    state.stop = follow(id, {
      onJob: update, onProgress: (lines) => progress.add(lines), onGone: () => open(null),
      onLost: (lost) => { $("offline").hidden = !lost; },
    });
  } catch (error) {
    view("empty");
    fail(explain(error));
  }
}

/** The job has changed. */
function update(job) {
  const before = state.job;
  state.job = job;
  if (job.state === "ready" && job.analysis.up && settings.up !== job.analysis.up) { settings.up = job.analysis.up; settings.draw(); }
  if (before?.state !== job.state) refreshJobs();
  render();
  loadModel(job);
}

/** The model as it was uploaded, or the result, whichever the job has. */
async function loadModel(job) {
  const { analysis } = job, done = job.state === "finished" && job.files.includes("report.html");
  const wanted = done ? `${job.id}/result/${job.ended}` : analysis.model ? `${job.id}/${analysis.up}` : null;
  if (!wanted || wanted === state.shown) return;
  state.shown = wanted;
  try {
    if (done) { result.size = settings.of(job.settings).size_mm; await result.open(job); if (state.shown === wanted) { shapes(true); arrange(); } return; }
    const own = state.local?.job === job.id && analysis.up === "auto" ? state.local.mesh : null;
    const mesh = own ?? await readGlb(await (await fetch(`/api/jobs/${job.id}/model.glb`)).arrayBuffer());
    if (state.shown !== wanted) return;
    if (viewer.mesh !== mesh) show(mesh);
    state.mesh = mesh;
    shapes(false);
    painting.use(mesh, analysis, () => settings.values.size_mm);
    arrange();
  } catch (error) {
    state.shown = null;
    $("view-message").textContent = t("view.unreadable");
  }
}

function show(mesh) {
  viewer.set({ shape: 1, split: null, brush: [0, 0, 0, 0] });
  viewer.setMesh(mesh);
  pickSurface(TEXTURE);
  shapes(false);
}

function pickSurface(value) { $("surfaces").querySelector(`[value="${value}"]`).checked = true; viewer.set({ surface: value }); }

/** With a result: before, after, and the relief in mm. */
function shapes(there) {
  $("shapes").hidden = !there;
  $("surfaces").querySelector(`[value="${RELIEF}"]`).parentElement.hidden = !there;
  if (there && !result.seen) { $("shapes").querySelector("[value=compare]").checked = true; pickSurface(ONE_COLOUR); result.seen = true; }
}

/** The view as the switches want it. */
function arrange() {
  const surface = Number($("surfaces").querySelector(":checked").value), there = !$("shapes").hidden;
  const shape = there ? $("shapes").querySelector(":checked")?.value ?? "compare" : "refined";
  const { size_mm: size, printer, stand } = state.job?.settings && state.job.state !== "ready" ? settings.of(state.job.settings) : settings.values;
  const machine = state.options.printers[printer], mm = there ? result.mm : size / Math.max(...(state.job?.analysis.model?.extent ?? [1]));
  state.mm = mm;
  const layer = machine?.layered ? [machine.layer_mm / mm, machine.bulge] : [0, 0.5];
  viewer.set({ surface, layer, turn: turnFor(there ? result.up : state.options.directions[stand] ?? [0, 1, 0]) });
  const compare = shape === "compare";
  $("split").hidden = !compare || !there;
  for (const tag of document.querySelectorAll(".tag")) tag.hidden = $("split").hidden;
  if (compare && there) viewer.set({ split: Number($("split").value) / 1000 });
  else { viewer.set({ split: null }); if (there) viewer.morph(shape === "original" ? 0 : 1); }
  $("legend").hidden = surface !== RELIEF || !there;
  const [low, , high] = $("legend").children;
  low.textContent = `−${number(result.cap ?? 1)} mm`;
  high.textContent = `+${number(result.cap ?? 1)} mm`;
  $("surfaces").querySelector(`[value="${PRINTED}"]`).disabled = !machine?.layered;
  $("surfaces").querySelector(`[value="${PRINTED}"]`).parentElement.title = machine?.layered ? "" : t("surface.no-layers");
  if (surface === PRINTED && !machine?.layered) pickSurface(ONE_COLOUR);
  painting.rescale(mm);
  about();
}

/** Millimetres at the middle of the view, in round numbers. */
function ruler() {
  const bar = document.querySelector(".ruler"), perMm = viewer.scale / (state.mm || 1);
  const step = [0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500].find((mm) => mm * perMm > 70) ?? 1000;
  bar.hidden = !state.job || !(perMm > 0);
  bar.firstElementChild.style.width = `${step * perMm}px`;
  bar.lastElementChild.textContent = `${number(step)} mm`;
}

/** All cards, from the job. */
function render() {
  drawJobs();
  const { job } = state;
  if (!job) return;
  document.title = `${job.name} – genmf`;
  const ready = job.state === "ready", done = job.state === "finished", failed = job.analysis.state === "failed";
  about();
  $("about").hidden = false;
  $("settings").hidden = !ready || failed;
  $("painting").hidden = !ready || failed;
  $("progress").hidden = !["queued", "running"].includes(job.state);
  $("result").hidden = !done;
  if (!$("progress").hidden) progress.render(job, state.jobs);
  if (done) result.render(job);
  if (!ready) painting.stop();
  const reading = job.analysis.state === "reading", message = reading ? t("analysis.reading") : "";
  if (viewer.ok) $("view-message").textContent = message;
  if (job.state === "failed") $("error").textContent = sentence(job.error);
  else if (ready || done) $("error").textContent = "";
  actions(job, failed);
}

function about() {
  const { job } = state;
  if (!job) return;
  const { analysis } = job, { model } = analysis, size = (job.settings ? settings.of(job.settings) : settings.values).size_mm;
  const longest = Math.max(...(model?.extent ?? [1])), mm = model?.extent.map((x) => (x / longest) * size);
  const lines = analysis.state === "failed" ? [{ severity: "error", words: sentence(analysis.error) }]
    : (analysis.findings ?? []).map((f) => ({ severity: f.severity, words: plural(`finding.${f.code}`, f.count ?? 0) }));
  if (analysis.state === "checking") lines.push({ severity: "info", words: t("analysis.checking") });
  $("about").replaceChildren(
    el("h1", {}, el("span", {}, job.name), el("button", { type: "button", class: "link", onclick: remove, disabled: job.state === "running" }, t("jobs.delete"))),
    model ? el("p", { class: "size" }, t("about.size", { x: number(mm[0]), y: number(mm[2]), z: number(mm[1]), faces: number(model.faces, 0) })) : "",
    el("ul", { class: "findings" }, ...lines.map(({ severity, words: text }) => el("li", { class: severity }, el("span", {}, text)))),
  );
}

function actions(job, failed) {
  const button = (key, act, kind = "quiet", disabled = false) => {
    const made = el("button", { type: "button", class: kind, id: `do-${key}`, disabled }, t(`action.${key}`));
    made.addEventListener("click", async () => { made.disabled = true; fail(""); try { await act(); } catch (error) { fail(["asset", "setting", "conflict"].includes(error.code) ? sentence(error.message) : explain(error)); made.disabled = false; } });
    return made;
  };
  const post = (what, json) => async () => update(await ask(`jobs/${job.id}/${what}`, { method: "POST", json }));
  const again = async () => { const copy = await ask(`jobs/${job.id}/copy`, { method: "POST" }); await refreshJobs(); location.hash = `job=${copy.id}`; };
  const textured = job.analysis.model?.textured !== false;
  const start = async () => { await save(true); await post("start", { settings: settings.wanted(job.analysis.up), regions: painting.regions })(); };
  const shown = {
    ready: () => [button("start", start, "main", failed || !textured || !job.analysis.model)],
    queued: () => [button("cancel", post("cancel"))],
    running: () => [button("cancel", post("cancel"), "quiet", job.cancelling), button("keep", post("keep"), "main", !job.can_keep || job.stopping)],
    finished: () => [button("again", again), job.can_continue ? button("continue", post("resume")) : null],
    failed: () => [button("again", again), job.can_continue ? button("continue", post("resume"), "main") : null],
    cancelled: () => [button("again", again), job.can_continue ? button("continue", post("resume"), "main") : null],
  }[job.state]().filter(Boolean);
  const same = shown.length === $("actions").children.length && shown.every((b, i) => b.id === $("actions").children[i].id && b.disabled === $("actions").children[i].disabled && b.textContent === $("actions").children[i].textContent);
  $("actions").hidden = false;
  if (!same || $("actions").dataset.job !== job.id) $("actions").replaceChildren(...shown); // else the focus would be lost
  $("actions").dataset.job = job.id;
}

/** Settings and strokes are kept with the job as they change, so that a reload loses nothing. */
function save(now = false) {
  clearTimeout(state.saving);
  const { job } = state;
  if (!job || job.state !== "ready") { state.saving = null; return null; }
  const draft = { settings: settings.wanted(job.analysis.up), regions: painting.regions, turn: painting.turn };
  const send = () => { state.saving = null; return fetch(`/api/jobs/${job.id}/draft`, { method: "PUT", body: JSON.stringify(draft), keepalive: now === true && JSON.stringify(draft).length < 60000 }).catch(() => null); };
  if (now === true) return send();
  state.saving = setTimeout(send, 400);
  return null;
}

/** The file is read again, with another axis upwards; strokes turn with it. */
async function turn(up) {
  try { update(await ask(`jobs/${state.job.id}/up`, { method: "POST", json: { up } })); } catch (error) { fail(explain(error)); }
  save();
}

async function remove() {
  const { job } = state;
  try {
    await ask(`jobs/${job.id}`, { method: "DELETE" });
  } catch (error) { return fail(explain(error)); }
  await open(null);
  await refreshJobs();
  const undo = el("button", { type: "button" }, t("jobs.undo"));
  undo.addEventListener("click", async () => { await ask(`jobs/${job.id}/restore`, { method: "POST" }); $("toast").replaceChildren(); await refreshJobs(); location.hash = `job=${job.id}`; });
  $("toast").replaceChildren(el("span", {}, t("jobs.deleted", { name: job.name })), undo);
  setTimeout(() => $("toast").contains(undo) && $("toast").replaceChildren(), 12000);
}

async function refreshJobs() {
  try { state.jobs = (await ask("jobs")).jobs; $("offline").hidden = true; drawJobs(); } catch { $("offline").hidden = false; }
}

function drawJobs() {
  const focused = document.activeElement?.dataset?.job;
  $("jobs").replaceChildren(
    ...(state.jobs.length ? [el("button", { type: "button", class: "chip", "data-job": "new", "aria-current": state.job ? "false" : "true", onclick: () => open(null) }, el("span", {}, `+ ${t("jobs.new")}`))] : []),
    ...state.jobs.map((job) => el("button", {
      type: "button", class: "chip", "data-job": job.id, "aria-current": job.id === state.job?.id ? "true" : "false", title: `${job.name}: ${t(`state.${job.state}`)}`,
      onclick: () => { location.hash = `job=${job.id}`; },
    }, el("i", { class: job.state, "aria-hidden": "true" }), el("span", {}, job.name), el("span", { class: "hidden" }, t(`state.${job.state}`)))),
  );
  if (focused) document.querySelector(`#jobs [data-job="${CSS.escape(focused)}"]`)?.focus();
}

begin().catch((error) => { view("empty"); fail(error.message); });
