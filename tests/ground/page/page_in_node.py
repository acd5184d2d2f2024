"""The page's whole script without a browser: in Node, before elements that only keep their words, by a clock that the
test moves.
"""

import json
import re
import shutil
import subprocess
from importlib import resources
from typing import Any

PAGE = resources.files("agent.ground.page").joinpath("index.html").read_text(encoding="utf-8")
NODE = shutil.which("node")

BROWSER = """
let wall_ms = 1000, timers = [], frames = [], sent = [];
const anything = new Proxy(function () {}, {
  get: (_, name) => name === Symbol.toPrimitive ? () => 0 : anything, apply: () => anything, set: () => true});
class Node_ {
  constructor(words = "") { Object.assign(this, {words, children: [], style: {}, className: "", parentNode: null}); }
  get classList() {
    const all = () => new Set(this.className.split(" ").filter(Boolean));
    const keep = set => { this.className = [...set].join(" "); };
    const toggle = (n, on) => { const s = all(); if (on ?? !s.has(n)) s.add(n); else s.delete(n); keep(s); };
    return {toggle, add: n => toggle(n, true), remove: n => toggle(n, false), contains: n => all().has(n)};
  }
  get textContent() { return this.words + this.children.map(c => c.textContent).join(""); }
  set textContent(words) { this.children = []; this.words = String(words); }
  own(nodes) {
    return nodes.map(n => Object.assign(n instanceof Node_ ? n : new Node_(String(n)), {parentNode: this}));
  }
  append(...nodes) { this.children.push(...this.own(nodes)); }
  prepend(...nodes) { this.children.unshift(...this.own(nodes)); }
  replaceChildren(...nodes) { this.words = ""; this.children = this.own(nodes); }
  remove() { const p = this.parentNode; if (p) p.children = p.children.filter(c => c !== this); }
  get firstChild() { return this.children[0]; }
  get lastChild() { return this.children.at(-1); }
  get previousSibling() { const all = this.parentNode.children; return all[all.indexOf(this) - 1]; }
  querySelector(css) { return this.children.find(c => c.classList.contains(css.slice(1))) || null; }
  setAttribute() {} removeAttribute() {} addEventListener() {} focus() {} scrollIntoView() {} showModal() {}
  getContext() { return anything; }
  getBoundingClientRect() { return {left: 0, top: 0}; }
  get clientWidth() { return 300; }
  get clientHeight() { return 225; }
}
const elements = new Map(), keys = [];
const document = {
  documentElement: new Node_(), body: new Node_(), activeElement: null, createElement: () => new Node_(),
  getElementById: id => { if (!elements.has(id)) elements.set(id, new Node_()); return elements.get(id); }};
const getComputedStyle = () => ({getPropertyValue: () => ""}), matchMedia = () => new Node_();
const devicePixelRatio = 1, innerHeight = 900, location = {hash: "#token", host: "here"};
const addEventListener = (kind, act) => { if (kind === "keydown") keys.push(act); };
const performance = {now: () => wall_ms}, requestAnimationFrame = act => { frames.push(act); };
const setInterval = (act, every_ms) => timers.push({act, every_ms, at_ms: wall_ms + every_ms});
const setTimeout = (act, ms) => timers.push({act, at_ms: wall_ms + ms});
class WebSocket {
  constructor() { this.readyState = 1; WebSocket.last = this; }
  send(text) { sent.push(JSON.parse(text)); }
}
"""
TEST = """
const say = (...messages) => WebSocket.last.onmessage({data: JSON.stringify(messages)});
const press = key => keys.forEach(act => act({key, target: {matches: () => false}, preventDefault: () => {}}));
const draw = () => frames.splice(0).forEach(act => act());
function passes(ms, each = () => {}) {   // `each`: what the server says, at each twentieth of a second
  for (const end_ms = wall_ms + ms; wall_ms < end_ms;) {
    wall_ms += 50; each();
    for (const t of timers.filter(t => t.at_ms <= wall_ms)) {
      if (t.every_ms) t.at_ms += t.every_ms; else timers = timers.filter(o => o !== t);
      t.act();
    }
    draw();
  }
}
const says = id => $(id).textContent, age = name => robots.get(name).card.age.textContent;
console.error = error => { throw error; };
WebSocket.last.onopen();
"""


def page_does(test: str, **given: Any) -> Any:
    """What `test`, JavaScript that ends with a return, gives; `given` are constants of it."""
    (script,) = re.findall(r'<script nonce="NONCE">(.*)</script>', PAGE, re.DOTALL)
    about = "".join(f"const {name} = {json.dumps(value)};\n" for name, value in given.items())
    run = f"const result = (() => {{ {about} {test} }})(); process.stdout.write(JSON.stringify(result));"
    whole = "\n".join(['"use strict";', BROWSER, script, TEST, run])
    done = subprocess.run([NODE, "-"], input=whole, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
