"""What the 3-D view shows: computed once for all pages, and drawn by three.js in the browser."""
