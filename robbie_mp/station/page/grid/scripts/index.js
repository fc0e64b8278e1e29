// GridStack 14.1.0 (gridstackjs.com, MIT; see LICENSE) as a module. It is part of the package, so that the page
// needs no internet.
import "./gridstack-all.js";

export const GridStack = globalThis.GridStack;
