// For a page with panels from elsewhere: loads the font of all icons beside that of ours, and the compiler of styles.
window.first_picture.then(async () => {
  const root = ROOT;
  const fonts = await (await fetch(`${root}/fonts.css`)).text();
  const [, file] = fonts.match(/"Material Icons";[^}]*?url\((.*?)\)/);
  const font = new FontFace("Material Icons", `url(${root}/${file})`);
  document.fonts.add(await font.load());
  document.head.append(Object.assign(document.createElement("script"), { src: `${root}/tailwindcss.min.js` }));
});
