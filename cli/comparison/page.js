// Tables sort by the heading that is clicked, or chosen with Enter.
document.querySelectorAll("th[data-column]").forEach(function (head) {
  function sort() {
    var order = head.dataset.order === "1" ? -1 : 1, column = Number(head.dataset.column), table = head.closest("table"), body = table.tBodies[0];
    table.querySelectorAll("th").forEach(function (other) { delete other.dataset.order; other.removeAttribute("aria-sort"); });
    head.dataset.order = order;
    head.setAttribute("aria-sort", order > 0 ? "ascending" : "descending");
    function value(row) { var cell = row.cells[column]; return cell.dataset.value || cell.textContent.trim(); }
    Array.from(body.rows).sort(function (a, b) {
      var x = value(a), y = value(b);
      if (x === "" || y === "") { return (x === "") - (y === ""); }  // what has no value stays last
      var difference = Number(x) - Number(y);
      return order * (isNaN(difference) ? x.localeCompare(y, undefined, { numeric: true }) : difference);
    }).forEach(function (row) { body.appendChild(row); });
  }
  head.addEventListener("click", sort);
  head.addEventListener("keydown", function (event) { if (event.key === "Enter") { sort(); } });
});
