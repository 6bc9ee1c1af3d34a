// Sets the theme before the page is drawn; main.js changes it later.
document.documentElement.dataset.theme = ["light", "dark"].includes(localStorage.getItem("egp-theme"))
  ? localStorage.getItem("egp-theme")
  : matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
