"""How a report's page looks: on a desk, on a phone, in the dark, on paper."""

STYLE = """
:root { --ink: #23272e; --quiet: #656c77; --line: #dfe2e6; --paper: #fff; --wash: #f4f5f7; --mark: #2563a8 }
* { box-sizing: border-box }
html { -webkit-text-size-adjust: 100% }
body { margin: 0 auto; padding: 2.2rem 1.1rem 4rem; max-width: 48rem;
  background: var(--paper); color: var(--ink);
  font: 1rem/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", "DejaVu Sans", sans-serif;
  font-variant-numeric: tabular-nums; overflow-wrap: break-word }
p, li, figcaption, dd { text-wrap: pretty }
.eyebrow { margin: 0; color: var(--quiet); font-size: .85rem }
h1 { margin: .5rem 0 1rem; font-size: clamp(1.45rem, 4.6vw, 2rem); line-height: 1.2; font-weight: 650;
  letter-spacing: -.01em; text-wrap: balance }
h2 { margin: 3rem 0 .6rem; padding-top: .9rem; border-top: 1px solid var(--line); font-size: 1.2rem;
  line-height: 1.3; font-weight: 650 }
.lede { font-size: 1.1rem }
b, strong { font-weight: 650 }
code { font: .92em ui-monospace, SFMono-Regular, Menlo, Consolas, "DejaVu Sans Mono", monospace }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .35rem 1.2rem; margin: 1.2rem 0 }
dt { color: var(--quiet) }
dd { margin: 0 }
figure { margin: 1.4rem 0 2rem; break-inside: avoid; counter-increment: figure }
figure img { display: block; width: 100%; height: auto }
figcaption { margin-top: .5rem; color: var(--quiet); font-size: .88rem; line-height: 1.45 }
figcaption::before { content: "Figure " counter(figure) ". "; color: var(--ink); font-weight: 650 }
.wide { overflow-x: auto }
.wide img { min-width: 27rem }
table { border-collapse: collapse; width: 100%; margin: 1rem 0; font-size: .88rem; line-height: 1.4 }
th, td { padding: .32rem .9rem .32rem 0; border-bottom: 1px solid var(--line); text-align: left;
  vertical-align: top }
th { color: var(--quiet); font-weight: 500; border-bottom-color: var(--quiet) }
th:last-child, td:last-child { padding-right: 0 }
.number { text-align: right; white-space: nowrap }
tr.chosen td { background: var(--wash) }
tr.chosen td:first-child { box-shadow: -3px 0 0 var(--mark) }
small { color: var(--quiet); font-size: .92em }
footer { margin-top: 3rem; padding-top: .9rem; border-top: 1px solid var(--line); color: var(--quiet);
  font-size: .85rem }
@media (max-width: 32rem) {
  dl { grid-template-columns: 1fr; gap: 0 } dd { margin-bottom: .6rem }
  table { min-width: 34rem }
}
@media screen and (prefers-color-scheme: dark) {
  :root { --ink: #e3e6ea; --quiet: #9aa2ad; --line: #33373d; --paper: #121212; --wash: #1c1f23;
    --mark: #6aa5e8 }
  figure img { filter: invert(.93) hue-rotate(180deg) }
}
@media print {
  body { max-width: none; padding: 0; font-size: 10pt }
  h2 { margin-top: 1.6rem; break-after: avoid }
  figure { margin: .8rem 0 1rem } figure img { width: 84% }
  .wide { overflow: visible } .wide img, table { min-width: 0 }
  tr { break-inside: avoid }
}
"""
