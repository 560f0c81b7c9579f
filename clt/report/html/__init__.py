"""The interactive report: one page that opens offline. Numbers here, drawing in `report.js`."""
