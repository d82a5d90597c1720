// Turns the scene: the marks of the figure have their points in space, `data-at`, and are placed anew.
"use strict";
(() => {
  // Margins, px, and width of a number, as in scene.rs.
  const MARGIN = [72, 44], NUMBERS = 62, NUMBER = 27;
  // Step of a key and of a px of a drag, rad, and limits of the height of the view.
  const KEY = 0.1, DRAG = 0.008, RAISED = [-0.2, 1.5];

  const points = text => text.split(" ").map(point => point.split(",").map(Number));
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

  for (const svg of document.querySelectorAll("svg[data-scene]")) {
    const [angles, low, high] = points(svg.dataset.scene);
    const { width, height } = svg.viewBox.baseVal;
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map(i => low.map((x, axis) => ((i >> axis) & 1 ? high[axis] : x)));
    const most = height - NUMBERS - 1.4 * MARGIN[1];

    const projection = (turned, raised) => {
      const [sin, cos] = [Math.sin(turned), Math.cos(turned)];
      const into = [-Math.cos(raised) * cos, Math.sin(raised), Math.cos(raised) * sin];
      const right = [sin, 0, cos];
      const down = [into[1] * right[2], into[2] * right[0] - into[0] * right[2], -into[1] * right[0]];
      const x = corners.map(p => dot(right, p)), y = corners.map(p => dot(down, p));
      const [left, top] = [Math.min(...x), Math.min(...y)];
      const [across, along] = [Math.max(...x) - left, Math.max(...y) - top];
      const scale = Math.min((width - 2 * MARGIN[0]) / across, most / along);
      const origin = [(width - scale * (2 * left + across)) / 2, NUMBERS + MARGIN[1] / 2 - scale * top];
      return p => [origin[0] + scale * dot(right, p), origin[1] + scale * dot(down, p)];
    };

    const start = projection(...angles);
    const marks = [...svg.querySelectorAll("[data-at]")].map(mark => {
      const at = points(mark.dataset.at);
      const [x, y] = start(at[0]);
      const shift = mark.tagName === "text" ? [mark.getAttribute("x") - x, mark.getAttribute("y") - y] : [0, 0];
      return { mark, at, shift, end: mark.getAttribute("d")?.endsWith("z") ? "z" : "" };
    });
    const numbered = marks.filter(({ mark }) => mark.dataset.number !== undefined);
    let [turned, raised] = angles;

    // Places the numbers of the frames in a row, so that none hides another.
    function placeNumbers(place) {
      const tops = numbered.map(({ mark, at }) => ({ mark, top: at.map(place).reduce((a, b) => (b[1] < a[1] ? b : a)) }));
      tops.sort((a, b) => a.top[0] - b.top[0]);
      let left = 0;
      const row = tops.map(({ top }) => (left = Math.max(left + NUMBER, top[0])));
      let limit = width;
      for (let i = row.length - 1; i >= 0; i--) limit = row[i] = Math.min(row[i], limit - NUMBER);
      tops.forEach(({ mark, top }, i) => {
        mark.setAttribute("d", `M${row[i]} 29L${top[0]} ${top[1]}`);
        mark.nextElementSibling.setAttribute("x", row[i]);
      });
    }

    function turn(by, up) {
      turned += by;
      raised = Math.min(Math.max(raised + up, RAISED[0]), RAISED[1]);
      const place = projection(turned, raised);
      for (const { mark, at, shift, end } of marks) {
        const [x, y] = place(at[0]);
        if (mark.tagName === "circle") {
          mark.setAttribute("cx", x);
          mark.setAttribute("cy", y);
        } else if (mark.tagName === "text") {
          mark.setAttribute("x", x + shift[0]);
          mark.setAttribute("y", y + shift[1]);
        } else {
          mark.setAttribute("d", `M${at.map(p => place(p).map(c => c.toFixed(1)).join(" ")).join("L")}${end}`);
        }
      }
      placeNumbers(place);
    }
    const reset = () => turn(angles[0] - turned, angles[1] - raised);

    svg.tabIndex = 0;
    svg.setAttribute("role", "application");
    svg.setAttribute("aria-roledescription", "scene to turn");
    svg.style.cursor = "grab";
    svg.style.touchAction = "none";
    svg.onpointerdown = event => svg.setPointerCapture(event.pointerId);
    svg.onpointermove = event => {
      if (svg.hasPointerCapture(event.pointerId)) turn(-event.movementX * DRAG, event.movementY * DRAG);
    };
    svg.ondblclick = reset;
    svg.onkeydown = event => {
      const actions = {
        ArrowLeft: () => turn(KEY, 0), ArrowRight: () => turn(-KEY, 0),
        ArrowUp: () => turn(0, -KEY), ArrowDown: () => turn(0, KEY), 0: reset,
      };
      const action = actions[event.key];
      if (!action || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      action();
    };
    svg.parentElement.querySelector("figcaption")?.append(
      " Drag the scene, or use the arrow keys, to turn it; 0 or a double click turns it back.");
  }
})();
