"""The contents of the 3-D view: computed once for all pages, and drawn by three.js in the browser."""
