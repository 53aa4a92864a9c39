// The HTTP API, as docs/http_api.md describes it.

/** Asks the server; throws an error with `code` and a sentence. */
export async function ask(path, { method = "GET", json, body } = {}) {
  let answer;
  try {
    answer = await fetch(`/api/${path}`, { method, body: json === undefined ? body : JSON.stringify(json) });
  } catch {
    throw Object.assign(new Error("The server does not answer."), { code: "no-server" });
  }
  if (answer.ok) return answer.status === 204 ? null : answer.json();
  const said = await answer.json().catch(() => null);
  throw Object.assign(new Error(said?.error?.message ?? answer.statusText), { code: said?.error?.code ?? "error" });
}

/** Sends a file, telling how far it is (0 to 1). */
export function upload(file, name, told) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    const refuse = (code, message) => reject(Object.assign(new Error(message), { code }));
    request.open("POST", `/api/jobs?name=${encodeURIComponent(name)}`);
    request.upload.onprogress = (event) => event.lengthComputable && told(event.loaded / event.total);
    request.onerror = () => refuse("no-server", "The server does not answer.");
    request.onload = () => {
      let said = null;
      try { said = JSON.parse(request.responseText); } catch { /* said stays null */ }
      if (request.status === 201) resolve(said);
      else refuse(said?.error?.code ?? "error", said?.error?.message ?? request.statusText);
    };
    request.send(file);
  });
}

/** Follows a job: `onJob(job)` whenever it changes, `onProgress(lines)`, `onGone()`; returns what ends that. */
export function follow(id, { onJob, onProgress, onGone, onLost }) {
  const source = new EventSource(`/api/jobs/${id}/events`);
  source.addEventListener("job", (event) => { onLost(false); onJob(JSON.parse(event.data)); });
  source.addEventListener("progress", (event) => onProgress(JSON.parse(event.data)));
  source.addEventListener("gone", () => { source.close(); onGone(); });
  source.onerror = () => onLost(true);
  return () => source.close();
}

export const fileUrl = (job, name, download = false) => `/api/jobs/${job.id}/files/${name}${download ? "?download" : ""}`;
