/**
 * Drives a page in Firefox or in a WebKit as a person would: a part of what drive.mjs does in Chromium,
 * with the same questions. Both are the browsers that distributions ship, in a window of an X server.
 */
import { spawn } from "node:child_process";
import { createInterface } from "node:readline";

import puppeteer from "puppeteer-core";

import { NAMES, waitFor } from "./names.mjs";

/** @typedef {"run" | "wait" | "press" | "drag" | "click"} Question */

/** Firefox by WebDriver BiDi. */
class Firefox {
  /** @type {string[]} */
  complaints = [];

  /** @param {string} executablePath */
  static async start(executablePath) {
    const browser = await puppeteer.launch({
      browser: "firefox",
      executablePath,
      headless: false, // without a window it has no WebGL2
      extraPrefsFirefox: { "webgl.force-enabled": true, "gfx.x11-egl.force-enabled": true },
    });
    return new Firefox(browser, await browser.newPage());
  }

  /** @param {import("puppeteer-core").Browser} browser @param {import("puppeteer-core").Page} page */
  constructor(browser, page) {
    this.browser = browser;
    this.page = page;
    page.on("pageerror", (error) => this.complaints.push(String(error)));
    page.on("console", (message) => {
      if (["error", "warn"].includes(message.type())) this.complaints.push(message.text());
    });
  }

  /** @param {string} url @param {number} width @param {number} height */
  async open(url, width, height) {
    await this.page.setViewport({ width, height });
    await this.page.goto(url);
  }

  /** @param {string} code an expression @returns {Promise<any>} */
  evaluate(code) {
    return this.page.evaluate(code);
  }

  /** @param {string} key */
  press(key) {
    return this.page.keyboard.press(/** @type {any} */ (key));
  }

  /** @param {number[]} from @param {number[]} to */
  async drag(from, to) {
    const { mouse } = this.page;
    await mouse.move(from[0], from[1]);
    await mouse.down();
    await mouse.move(to[0], to[1], { steps: 5 });
    await mouse.up();
  }

  close() {
    return this.browser.close();
  }
}

/** WebKit by WebDriver: its driver is a server of its own. */
class WebKit {
  /** @type {string[]} the driver tells none */
  complaints = [];

  /** @param {string} browser @param {string} driver */
  static async start(browser, driver) {
    const port = 20_000 + (process.pid % 20_000);
    const env = {
      ...process.env,
      WEBKIT_DISABLE_SANDBOX_THIS_IS_DANGEROUS: "1", // a container has no namespaces to give
      LIBGL_ALWAYS_SOFTWARE: "1",
    };
    const server = spawn(driver, [`--port=${port}`], { env, stdio: "ignore" });
    const options = { binary: browser, args: ["--automation"] };
    const alwaysMatch = { "webkitgtk:browserOptions": options };
    for (;;) {
      try {
        const url = `http://127.0.0.1:${port}/session`;
        const { sessionId } = await asked(url, { capabilities: { alwaysMatch } });
        return new WebKit(server, `${url}/${sessionId}`);
      } catch (error) {
        if (!(error instanceof TypeError)) throw error; // it does not listen yet
        await new Promise((resolve) => setTimeout(resolve, 100));
      }
    }
  }

  /** @param {import("node:child_process").ChildProcess} server @param {string} url */
  constructor(server, url) {
    this.server = server;
    this.url = url;
  }

  /** @param {string} url @param {number} width @param {number} height */
  async open(url, width, height) {
    await asked(`${this.url}/timeouts`, { script: 600_000 });
    await asked(`${this.url}/url`, { url });
    // The size of the window is that of the page and what is around it.
    const [over, above] = await this.evaluate(
      "Promise.resolve([outerWidth - innerWidth, outerHeight - innerHeight])",
    );
    await asked(`${this.url}/window/rect`, { width: width + over, height: height + above });
  }

  /** @param {string} code an expression @returns {Promise<any>} */
  async evaluate(code) {
    const script = `const done = arguments[0];
      Promise.resolve(${code}).then((value) => done({ value }), (error) => done({ error: String(error) }));`;
    const { value, error } = await asked(`${this.url}/execute/async`, { script, args: [] });
    if (error !== undefined) throw new Error(error);
    return value;
  }

  /** @param {string} key */
  press(key) {
    const value = KEYS[key] ?? key;
    const strokes = [
      { type: "keyDown", value },
      { type: "keyUp", value },
    ];
    const actions = [{ type: "key", id: "keys", actions: strokes }];
    return asked(`${this.url}/actions`, { actions });
  }

  /** @param {number[]} from @param {number[]} to */
  drag([fromX, fromY], [toX, toY]) {
    const moves = [1, 2, 3, 4, 5].map((n) => {
      const share = n / 5;
      const [x, y] = [fromX + share * (toX - fromX), fromY + share * (toY - fromY)];
      return { type: "pointerMove", x: Math.round(x), y: Math.round(y), duration: 20 };
    });
    const actions = [
      { type: "pointerMove", x: fromX, y: fromY },
      { type: "pointerDown", button: 0 },
      ...moves,
      { type: "pointerUp", button: 0 },
    ];
    const mouse = { type: "pointer", id: "mouse", parameters: { pointerType: "mouse" }, actions };
    return asked(`${this.url}/actions`, { actions: [mouse] });
  }

  async close() {
    await fetch(this.url, { method: "DELETE" });
    this.server.kill();
  }
}

/** Keys by their code in WebDriver. @type {Record<string, string>} */
const KEYS = { Escape: "\ue00c", Home: "\ue011", End: "\ue010" };

/** @param {string} url @param {unknown} body @returns {Promise<any>} */
async function asked(url, body) {
  const answer = await fetch(url, { method: "POST", body: JSON.stringify(body) });
  const { value } = await answer.json();
  if (!answer.ok) throw new Error(`${url}: ${value.error}: ${value.message}`);
  return value;
}

const [kind, executablePath, driver] = process.argv.slice(2);
const browser = await (kind === "firefox"
  ? Firefox.start(executablePath)
  : WebKit.start(executablePath, driver));

/** @type {Record<string, (question: any) => unknown>} */
const ACTIONS = {
  open: ({ url, widthPx, heightPx }) => browser.open(url, widthPx, heightPx),
  rest: () => browser.open("about:blank", 320, 240),
  run: ({ code, value }) =>
    browser.evaluate(`(async (value) => {${NAMES}{${code}}})(${JSON.stringify(value ?? null)})`),
  wait: ({ code, timeoutS }) => waitFor((text) => browser.evaluate(text), code, timeoutS),
  press: ({ key }) => browser.press(key),
  drag: ({ fromPx, toPx }) => browser.drag(fromPx, toPx),
  takeComplaints: () => browser.complaints.splice(0),
};

for await (const line of createInterface({ input: process.stdin })) {
  const question = JSON.parse(line);
  let answer;
  try {
    answer = { value: (await ACTIONS[question.ask](question)) ?? null };
  } catch (error) {
    answer = { failed: `${/** @type {Error} */ (error).stack}`, complaints: browser.complaints };
  }
  process.stdout.write(`${JSON.stringify(answer)}\n`);
}
await browser.close();
