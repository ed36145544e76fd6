/**
 * Drives a page in a browser as a person would, for the tests: one JSON object a line in, one out.
 */
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { createInterface } from "node:readline";

import * as playwright from "playwright-core";

import { NAMES, waitFor } from "./names.mjs";

/**
 * Starts a browser; nothing else does. Another kind needs its arguments here, and its path in
 * tests/support/web/chromium.py.
 */
async function launch(/** @type {"chromium"} */ kind, /** @type {string} */ executablePath) {
  const args = {
    chromium: [
      "--use-angle=swiftshader",
      "--enable-unsafe-swiftshader",
      "--ignore-gpu-blocklist",
      // Only the canvas is drawn by what stands in for a GPU: the rest of a page is dear there.
      ...(keeps ? ["--disable-gpu-compositing", "--disable-gpu-rasterization"] : []),
    ],
  }[kind];
  return playwright[kind].launch({ executablePath, args });
}

const [kind, executablePath, boundS, keeps] = process.argv.slice(2);
const AXE = createRequire(import.meta.url).resolve("axe-core/axe.min.js");
const BOUND_MS = 1000 * Number(boundS);
const browser = await launch(/** @type {"chromium"} */ (kind), executablePath);
/** Runs before all else in a page: the person has been there, so the hint of a first visit is over. */
const RETURNING =
  'try { localStorage["swings-player-looked"] ??= "1" } catch { /* a page without storage has no hint */ }';
/**
 * Runs before all else in the pages of a suite, which draw on the CPU: 15 pictures a second at most
 * leave it to other tests.
 */
const SPARING = `{
  const { requestAnimationFrame } = window;
  const waiting = new Map();
  window.requestAnimationFrame = (action) => {
    const draw = (now) => waiting.delete(id) && action(now);
    const id = setTimeout(() => requestAnimationFrame(draw), 66);
    waiting.set(id);
    return id;
  };
  window.cancelAnimationFrame = (id) => waiting.delete(id);
}`;
/** @type {import("playwright-core").Page} */
let page;
/** @type {import("playwright-core").Page | import("playwright-core").Frame} the page, or a frame in it */
let scene;
/** What the context of the page was made with, if the next page may be opened in the same one. */
let kept = "";
/** @type {import("playwright-core").CDPSession} */
let session;
/** @type {string[]} the scripts that run in the page before its own */
let identifiers = [];
/** @type {string[]} errors and warnings of all pages since they were last asked for */
const complaints = [];

/** @type {Record<string, (question: any) => unknown>} */
const ACTIONS = {
  /**
   * `scripts` (paths) run in the page before its own; `options` are those of Playwright's context. With
   * "keep", a page of the same options is opened in the same process, with an empty cache: to start
   * another costs more than all that a small page does.
   */
  async open({ url, widthPx, heightPx, touch, scripts, options }) {
    const viewport = { width: widthPx, height: heightPx };
    const wanted = JSON.stringify([touch, options]);
    if (kept === wanted) {
      await page.setViewportSize(viewport);
      await session.send("Network.clearBrowserCache");
    } else {
      await ACTIONS.close({});
      const context = await browser.newContext({ viewport, hasTouch: touch, ...options });
      await context.addInitScript(RETURNING);
      if (keeps) await context.addInitScript(SPARING);
      if (!keeps) for (const path of scripts) await context.addInitScript({ path });
      page = await context.newPage();
      page.on("pageerror", (error) => complaints.push(`${error.stack}`));
      page.on("console", (message) => {
        if (!["error", "warning"].includes(message.type())) return;
        // What a slow device says of a test that reads the picture.
        if (message.text().includes("GPU stall due to ReadPixels")) return;
        // An interface of the machine came or went, as containers of other tests make them.
        if (message.text().includes("ERR_NETWORK_CHANGED")) return;
        complaints.push(message.text());
      });
      session = await context.newCDPSession(page);
      identifiers = [];
    }
    if (keeps) {
      kept = wanted;
      await session.send("Page.enable");
      for (const identifier of identifiers.splice(0)) {
        await session.send("Page.removeScriptToEvaluateOnNewDocument", { identifier });
      }
      for (const path of scripts) {
        const source = `(() => {${await readFile(path, "utf8")}\n})();`;
        const added = await session.send("Page.addScriptToEvaluateOnNewDocument", { source });
        identifiers.push(added.identifier);
      }
    }
    await page.goto(url);
    scene = page;
  },
  /** Ends what the page does. */
  async rest() {
    if (kept === "") return ACTIONS.close({});
    await page.mouse.move(0, 0);
    await page.goto("about:blank");
  },
  /** Opens the same address in a new page of the same browser, whose cache is warm. */
  async reopen({ restS }) {
    kept = "";
    const url = page.url();
    const next = await page.context().newPage();
    await page.close();
    page = scene = next;
    await new Promise((resolve) => setTimeout(resolve, 1000 * restS));
    await page.goto(url);
  },
  async close() {
    kept = "";
    await page?.context().close();
  },
  /** Goes into the frame whose URL holds `part`. */
  async enter({ part }) {
    const isIt = (/** @type {import("playwright-core").Frame} */ frame) =>
      frame.url().includes(part);
    scene = page.frames().find(isIt) ?? (await page.waitForEvent("framenavigated", isIt));
  },
  /**
   * Runs `code`, the body of an async function of `value`, in the page: as a whole expression, for a
   * page may forbid that it makes code of text.
   */
  async run({ code, value }) {
    const text = JSON.stringify(value ?? null);
    return scene.evaluate(`(async (value) => {${NAMES}{${code}}})(${text})`);
  },
  wait: ({ code, timeoutS }) => waitFor((text) => scene.evaluate(text), code, timeoutS),
  async press({ key }) {
    await page.keyboard.press(key);
  },
  async click({ selector }) {
    await scene.click(selector, { timeout: BOUND_MS });
  },
  async tap({ atPx }) {
    await page.touchscreen.tap(atPx[0], atPx[1]);
  },
  /** Turns the wheel away from the person by one step. */
  async wheel({ atPx }) {
    await page.mouse.move(atPx[0], atPx[1]);
    await page.mouse.wheel(0, -100);
  },
  async drag({ fromPx, toPx, button }) {
    await page.mouse.move(fromPx[0], fromPx[1]);
    await page.mouse.down({ button });
    await page.mouse.move(toPx[0], toPx[1], { steps: 5 });
    await page.mouse.up({ button });
  },
  /** Fingers at the places of each step, until the last one lifts them. */
  async touch({ steps }) {
    const session = await page.context().newCDPSession(page);
    const send = (/** @type {any} */ type, /** @type {number[][]} */ places) =>
      session.send("Input.dispatchTouchEvent", {
        type,
        touchPoints: places.map(([x, y], id) => ({ x, y, id })),
      });
    for (const [n, places] of steps.entries()) await send(n ? "touchMove" : "touchStart", places);
    await send("touchEnd", []);
    await session.detach();
    // The browser passes moves on with its next picture.
    await page.evaluate(
      "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))",
    );
  },
  /**
   * What axe-core has against a part of the page, or all of it, shadow trees and all: a line for each
   * element. What fades has faded.
   */
  async axe({ selector }) {
    const source = await readFile(AXE, "utf8");
    // A page's policy may forbid code made of text; that of a debugger is not the page's own.
    await scene.evaluate(source);
    const faded = `Promise.allSettled(
      [document, ...[...document.querySelectorAll("*")].map((one) => one.shadowRoot)]
        .flatMap((root) => root?.getAnimations() ?? [])
        .filter((one) => one.effect.getComputedTiming().endTime < Infinity)
        .map((one) => one.finished))`;
    await scene.evaluate(faded);
    const { violations } = await scene.evaluate(`axe.run(${JSON.stringify(selector ?? "html")})`);
    return violations.flatMap((/** @type {any} */ { id, impact, nodes }) =>
      nodes.map((/** @type {any} */ node) => `${impact} ${id}: ${node.target} ${node.html}`),
    );
  },
  async screenshot({ path, selector }) {
    const target = selector ? page.locator(selector) : page;
    await target.screenshot({ path });
  },
  async resize({ widthPx, heightPx }) {
    await page.setViewportSize({ width: widthPx, height: heightPx });
  },
  /** As a window that is moved to a screen of another resolution; its size has to change too. */
  async screen({ widthPx, heightPx, ratio }) {
    kept = "";
    const size = { width: widthPx, height: heightPx };
    const metrics = { ...size, deviceScaleFactor: ratio, mobile: false };
    await session.send("Emulation.setDeviceMetricsOverride", metrics);
  },
  async offline({ offline }) {
    kept = "";
    await page.context().setOffline(offline);
  },
  /** Bytes that the page and each of its workers hold, without what nobody refers to any more. */
  async heaps() {
    kept = "";
    const session = await page.context().newCDPSession(page);
    /** @type {string[]} */
    const workers = [];
    /** @type {Map<number, (result: any) => void>} */
    const asked = new Map();
    session.on("Target.attachedToTarget", ({ sessionId }) => workers.push(sessionId));
    session.on("Target.receivedMessageFromTarget", ({ message }) => {
      const { id, result } = JSON.parse(message);
      asked.get(id)?.(result);
    });
    await session.send("Target.setAutoAttach", {
      autoAttach: true,
      waitForDebuggerOnStart: false,
      flatten: false,
    });
    /** @param {string} sessionId @param {string} method @returns {Promise<any>} */
    const askWorker = async (sessionId, method) => {
      const id = asked.size;
      const answer = new Promise((resolve) => asked.set(id, resolve));
      const message = JSON.stringify({ id, method });
      await session.send("Target.sendMessageToTarget", { sessionId, message });
      return answer;
    };
    /** @type {((method: any) => Promise<any>)[]} */
    const asks = [(method) => session.send(method)];
    for (const worker of workers) asks.push((method) => askWorker(worker, method));
    const found = [];
    for (const ask of asks) {
      await ask("HeapProfiler.collectGarbage");
      const { usedSize, backingStorageSize } = await ask("Runtime.getHeapUsage");
      found.push(usedSize + backingStorageSize);
    }
    await session.detach();
    return found;
  },
  takeComplaints() {
    return complaints.splice(0);
  },
};

for await (const line of createInterface({ input: process.stdin })) {
  const question = JSON.parse(line);
  let answer;
  try {
    answer = { value: (await ACTIONS[question.ask](question)) ?? null };
  } catch (error) {
    answer = { failed: `${/** @type {Error} */ (error).stack}`, complaints };
  }
  process.stdout.write(`${JSON.stringify(answer)}\n`);
}
await browser.close();
