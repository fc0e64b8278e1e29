// Lets the map show a place, m in the map: also if no map is in sight, or there has not been one on this page yet.
window.show_on_map = (place) => {
  window.place_on_map = place; // which the map takes
  if (!document.getElementById("map-view")?.offsetParent) document.getElementById("tab-map")?.click();
  dispatchEvent(new Event("robbie-show-on-map"));
};
