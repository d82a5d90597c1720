// Debian's furo lacks the style that follows the system's dark mode, and has the one for a dark theme.
const dark = matchMedia("(prefers-color-scheme: dark)");
const follow = () => { document.body.dataset.theme = dark.matches ? "dark" : "light"; };
if (document.body.dataset.theme === "auto") {
  dark.addEventListener("change", follow);
  follow();
}
