// Listens to what the server sends, again when that is cut, and not in tabs that nobody sees.
const SILENT_MS = 7000, SOON_MS = 300, LATER_MS = 3000, AGAIN_MS = 10000;
// A browser has six connections to one server, for all of its tabs: beyond this many, those that nobody sees do
// without.
const UNSEEN = 2;

// address: of the stream; kinds: what takes each kind of message; become: told "heard", "lost", "full" or "resting"; "full":
// the server takes no more browsers than the number that comes with it; early: what the page brought with it, by kind
export const stream = (address, kinds, become, early) => {
  let source = null, openedMs = 0, heardMs = 0, cut = false, full = false, again = 0;
  const close = () => {
    clearTimeout(again);
    if (source) source.close();
    source = null;
  };
  const open = () => {
    close();
    openedMs = performance.now();
    if (!cut) heardMs = openedMs;
    source = new EventSource(address());
    for (const [kind, take] of Object.entries(kinds)) source.addEventListener(kind, (event) => {
      heardMs = performance.now();
      cut = false;
      become("heard");
      take(JSON.parse(event.data));
    });
    source.addEventListener("full", (event) => {
      full = true;
      become("full", Number(event.data));
    });
    // Proxies end long answers: nothing is lost if the next one comes.
    source.onerror = () => {
      close();
      if (cut && !full) become("lost");
      again = setTimeout(open, cut || full ? LATER_MS : SOON_MS);
      cut = true;
      full = false;
    };
  };
  setInterval(() => {
    if (!source) return;
    const now = performance.now();
    if (now - heardMs <= SILENT_MS) return;
    become("lost");
    // A connection that broke silently would never be noticed.
    if (now - openedMs > AGAIN_MS) { cut = true; open(); }
  }, 1000);

  const seen = () => document.visibilityState !== "hidden";
  let leave = null;  // the place of a tab that listens unseen
  const place = async (i) => i < UNSEEN && (await new Promise((found) => {
    navigator.locks.request(`unseen ${i}`, { ifAvailable: true }, (lock) => {
      found(lock !== null);
      return lock && new Promise((left) => { if (leave) left(); else leave = left; });
    });
  }) || place(i + 1));
  const attend = async () => {
    const placed = seen() || leave !== null || (Boolean(navigator.locks) && await place(0));
    if (seen() && leave) { leave(); leave = null; }
    if (!seen() && !placed) { close(); become("resting"); } else if (!source) open();
  };
  document.addEventListener("visibilitychange", attend);
  attend();
  // It is as old as the page, and holds for as long as if it had been heard then.
  if (early && performance.now() < SILENT_MS) {
    heardMs = 0;
    for (const [kind, shown] of Object.entries(early)) kinds[kind](shown);
  }
  return open;
};
