// The viewer as one module for pages that are served: what encoding.py joins for pages that are not.
export { Clock } from "./clock.js";
export { decode, unpack } from "./geometry.js";
export { mount } from "./viewer.js";
export { figure } from "./figure.js";
