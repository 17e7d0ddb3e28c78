"use strict";
(() => {
  const table = document.getElementById("medians");
  const body = table.tBodies[0];
  const headings = [...table.tHead.rows[0].cells];
  const form = document.querySelector(".filters");
  const shown = form.querySelector("output");

  // What a cell is sorted by: its number where it has one, null where that is missing, else its text.
  const keyOf = (row, column) => {
    const cell = row.cells[column];
    if (cell.dataset.value === undefined) return cell.textContent.trim();
    return cell.dataset.value === "" ? null : Number(cell.dataset.value);
  };

  const sortBy = (column) => {
    const heading = headings[column];
    const direction = heading.getAttribute("aria-sort") === "ascending" ? "descending" : "ascending";
    const sign = direction === "ascending" ? 1 : -1;
    const keyed = [...body.rows].map((row) => [keyOf(row, column), row]);
    keyed.sort(([a], [b]) => {
      if (a === null || b === null) return (a === null) - (b === null); // what is missing stays last
      return sign * (typeof a === "number" ? a - b : a.localeCompare(b, "en"));
    });
    body.append(...keyed.map(([, row]) => row));
    for (const other of headings) other.setAttribute("aria-sort", other === heading ? direction : "none");
  };
  headings.forEach((heading, column) => heading.firstElementChild.addEventListener("click", () => sortBy(column)));

  const filter = () => {
    const wanted = [...new FormData(form)].filter(([, value]) => value !== "");
    let count = 0;
    for (const row of body.rows) {
      row.hidden = !wanted.every(([name, value]) => row.dataset[name] === value);
      count += !row.hidden;
    }
    const arm = form.elements.arm.value;
    for (const block of document.querySelectorAll(".arm")) block.hidden = arm !== "" && block.dataset.arm !== arm;
    shown.textContent = `${count} of ${body.rows.length} rows`;
  };
  form.addEventListener("change", filter);
  form.addEventListener("reset", () => setTimeout(filter));
  form.addEventListener("submit", (event) => event.preventDefault());
  filter();

  // A printed page, and one that is opened at a section, shows what was closed.
  const open = (parts) => parts.forEach((part) => (part.open = true));
  addEventListener("beforeprint", () => open(document.querySelectorAll("details")));
  open(document.querySelectorAll(location.hash ? `details${location.hash}` : "details[open]"));

  // One view plays at a time: browsers allow few pictures in 3D. A click on another one puts the button back.
  let playing = null;
  for (const button of document.querySelectorAll(".view button")) {
    button.addEventListener("click", () => {
      if (playing) playing.frame.replaceWith(playing.button);
      const frame = document.createElement("iframe");
      frame.title = button.textContent;
      frame.style.aspectRatio = button.style.aspectRatio;
      frame.srcdoc = PLAYER.replace("RECORDING", () => button.dataset.recording);
      button.replaceWith(frame);
      playing = { button, frame };
    });
  }
})();
