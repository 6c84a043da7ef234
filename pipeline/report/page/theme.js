"use strict";
// Light or dark: what was chosen last, on this page or another; else what the system has. Loaded before anything is drawn.

(() => {
  const root = document.documentElement, key = "haustra-theme";
  const kept = () => { try { return localStorage.getItem(key); } catch { return null; } }; // a page from disk may have no store
  const keep = theme => { try { localStorage.setItem(key, theme); } catch { /* it holds for this page */ } };
  if (["light", "dark"].includes(kept())) root.dataset.theme = kept();
  document.addEventListener("DOMContentLoaded", () => document.getElementById("theme").addEventListener("click", () => {
    root.dataset.theme = getComputedStyle(root).colorScheme === "dark" ? "light" : "dark";
    keep(root.dataset.theme);
  }));
})();
