"use strict";
// The ticks of a run that has ended, in the browser's own storage, so that the page has them after a reload. It keeps one
// run: the newest that ended.

// Does something with the store of runs, and returns its result.
function withRuns(mode, act) {
  return new Promise((done, failed) => {
    const open = indexedDB.open("stgdat", 1);
    open.onupgradeneeded = () => open.result.createObjectStore("runs");
    open.onerror = () => failed(open.error);
    open.onsuccess = () => {
      const transaction = open.result.transaction("runs", mode);
      const request = act(transaction.objectStore("runs"));
      transaction.oncomplete = () => {
        open.result.close();
        done(request.result);
      };
      transaction.onerror = transaction.onabort = () => failed(transaction.error);
    };
  });
}

// Keeps the ticks of a run; or, if more of them were kept before a reload, puts those into the ring. Returns whether it
// did.
async function keepOrRestore(run, ring) {
  const kept = await withRuns("readonly", (runs) => runs.get(run));
  if (kept && kept.ticks.length > ring.ticks.length) {
    Object.assign(ring, kept, { unpacked: { ordinal: -1, scene: null } });
    return true;
  }
  const { ticks, first, bytes, known } = ring;
  if (ticks.length) await withRuns("readwrite", (runs) => {
    runs.clear();
    return runs.put({ ticks, first, bytes, known }, run);
  });
  return false;
}
