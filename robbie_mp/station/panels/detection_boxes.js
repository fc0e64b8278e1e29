// Rectangles over a picture; each is [left, top, width, height, text], in shares of the picture's size.
export default {
  template: `<div class="detection-boxes"><div v-for="[left, top, width, height, text] in boxes" :key="[left, top, text]"
    :style="{ position: 'absolute', boxSizing: 'border-box', border: '2px solid #00e676', left: 100 * left + '%',
      top: 100 * top + '%', width: 100 * width + '%', height: 100 * height + '%' }">
    <span style="position: absolute; bottom: 100%; left: -2px; padding: 0 4px; background: #00e676; color: black;
      font-size: 0.75rem; white-space: nowrap">{{ text }}</span></div></div>`,
  props: { boxes: Array },
};
