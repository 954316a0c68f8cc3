// Requests: headers, errors in words, the token, and a reader of server-sent events that also notices comments.

import { ask } from "./dialog.js";

const BASE = new URL("api/v1", document.baseURI);
const KEPT = "stictiond.token";

/** An unsuccessful answer; `message` is in plain words. */
export class ApiError extends Error {
  constructor(status, message) {
    super(message);
    this.status = status;
  }
}

const WORDS = {
  0: "No answer: the network is down or the program has stopped. Retrying automatically.",
  401: "This needs the access token.",
  403: "This is not allowed from this computer.",
  404: "There is nothing with this name.",
  413: "This is larger than the program accepts.",
  429: "Too many requests at once. Wait a moment and try again.",
  503: "The program is busy or starting. Try again in a moment.",
};

/** URL of an API path, for links, pictures and downloads; complete paths from the server are passed through. */
export function url(path) {
  if (path.startsWith("/api/v1")) return BASE.pathname + path.slice(7);
  return BASE.pathname + path;
}

const token = () => sessionStorage.getItem(KEPT);

function headers(method, type) {
  const all = {};
  if (method !== "GET") {
    all["X-Stictiond"] = "1";
    all["Content-Type"] = type;
  }
  if (token()) all.Authorization = `Bearer ${token()}`;
  return all;
}

async function failure(response) {
  let words = null;
  try {
    words = (await response.json()).error;
  } catch {
    // The body has no text, so use the status.
  }
  return new ApiError(response.status, words ?? WORDS[response.status] ?? `The program answered with status ${response.status}.`);
}

let asking = null;

/** Asks for the token, one question at a time; resolves to whether one was given. */
function askToken(words) {
  asking ??= ask({
    title: "Token needed",
    intro: words,
    fields: [{ name: "token", label: "Token", type: "password", required: true, hint: "Kept until this tab is closed." }],
    submit: "Use it",
    onSubmit: ({ token: given }) => sessionStorage.setItem(KEPT, given.trim()),
  }).finally(() => (asking = null));
  return asking.then((values) => values !== null);
}

async function request(method, path, { body, type = "application/json", signal } = {}) {
  for (;;) {
    let response;
    try {
      response = await fetch(url(path), { method, body, signal, headers: headers(method, type), cache: "no-store" });
    } catch (error) {
      if (error.name === "AbortError") throw error;
      throw new ApiError(0, WORDS[0]);
    }
    if (response.ok) return response.status === 204 ? null : response.json();
    const error = await failure(response);
    if (response.status !== 401) throw error;
    sessionStorage.removeItem(KEPT);
    if (!(await askToken(error.message))) throw error;
  }
}

export const get = (path, options) => request("GET", path, options);
export const post = (path, body) => request("POST", path, { body: JSON.stringify(body) });
export const del = (path) => request("DELETE", path);

/** Sends a file with XMLHttpRequest, since fetch does not report the progress of uploads. */
export function upload(path, blob, { onProgress, signal } = {}) {
  return new Promise((resolve, reject) => {
    const x = new XMLHttpRequest();
    x.open("POST", url(path));
    for (const [name, value] of Object.entries(headers("POST", "application/octet-stream"))) x.setRequestHeader(name, value);
    x.upload.onprogress = (e) => onProgress?.(e.loaded, e.total);
    x.onerror = () => reject(new ApiError(0, WORDS[0]));
    x.onabort = () => reject(new DOMException("stopped", "AbortError"));
    signal?.addEventListener("abort", () => x.abort());
    x.onload = async () => {
      let answer = null;
      try {
        answer = JSON.parse(x.responseText);
      } catch {
        // Not JSON, so use the status.
      }
      if (x.status >= 200 && x.status < 300) return resolve(answer);
      const error = new ApiError(x.status, answer?.error ?? WORDS[x.status] ?? `The program answered with status ${x.status}.`);
      if (x.status !== 401) return reject(error);
      sessionStorage.removeItem(KEPT);
      if (!(await askToken(error.message))) return reject(error);
      upload(path, blob, { onProgress, signal }).then(resolve, reject);
    };
    x.send(blob);
  });
}

/** The path of a loop. */
export const loopPath = (name, rest = "") => `/loops/${encodeURIComponent(name)}${rest}`;

/** Splits a stream's text into events and passes them on; returns the incomplete rest. */
export function events(text, onEvent) {
  const blocks = text.replaceAll("\r\n", "\n").split("\n\n");
  const rest = blocks.pop();
  for (const block of blocks) {
    let event = "message";
    const data = [];
    for (const line of block.split("\n")) {
      if (line.startsWith("event:")) event = line.slice(6).trim();
      else if (line.startsWith("data:")) data.push(line.slice(5).trimStart());
    }
    if (data.length) onEvent(event, JSON.parse(data.join("\n")));
  }
  return rest;
}

/**
 * Server-sent events over fetch, so that comments count as news, the token goes along and a refusal has words.
 * `onEvent(name, data)`, `onBytes()` on anything heard, `onEnd(error or null)` once. Returns a function that closes it.
 */
export function stream(path, { onEvent, onBytes, onEnd }) {
  const control = new AbortController();
  let closed = false;
  const read = async () => {
    const response = await fetch(url(path), { signal: control.signal, headers: { ...headers("GET"), Accept: "text/event-stream" }, cache: "no-store" });
    if (!response.ok) throw await failure(response);
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
    const parts = [];
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return;
      onBytes?.();
      parts.push(value);
      // A long message comes in many parts: join them only when it is complete.
      if (value.includes("\n")) parts.splice(0, parts.length, events(parts.join(""), (name, data) => !closed && onEvent(name, data)));
    }
  };
  read().then(
    () => !closed && onEnd?.(null),
    (error) => !closed && onEnd?.(error instanceof ApiError ? error : new ApiError(0, WORDS[0])),
  );
  return () => {
    closed = true;
    control.abort();
  };
}
