#include "table.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "document.hpp"

namespace plenocal {

Table::Table(const std::string& path, const std::vector<std::string>& required)
    : path_(path), lines_(text_of(path)) {
  if (!next()) fail(path_, "is empty");
  for (std::size_t i = 0; i < cells_.size(); ++i) {
    if (!columns_.emplace(cells_[i], i).second) {
      fail(path_, "the first line names the column " + std::string(cells_[i]) + " twice");
    }
  }
  for (const std::string& name : required) {
    if (columns_.count(name) == 0) fail(path_, "the first line names no column " + name);
  }
}

bool Table::next() {
  while (std::getline(lines_, line_)) {
    ++number_;
    if (line_.find_first_not_of(" \t\r") == std::string::npos) continue;
    split();
    return true;
  }
  return false;
}

void Table::split() {
  const auto is_blank = [](char c) { return c == ' ' || c == '\t' || c == '\r'; };
  cells_.clear();
  const std::string_view line = line_;
  for (std::size_t begin = 0; begin <= line.size();) {
    const std::size_t end = std::min(line.find(',', begin), line.size());
    std::string_view cell = line.substr(begin, end - begin);
    while (!cell.empty() && is_blank(cell.front())) cell.remove_prefix(1);
    while (!cell.empty() && is_blank(cell.back())) cell.remove_suffix(1);
    cells_.push_back(cell);
    begin = end + 1;
  }
}

double Table::number(const std::string& name) const {
  const std::string text = this->text(name);
  std::size_t used = 0;
  double value = std::numeric_limits<double>::quiet_NaN();
  try {
    value = std::stod(text, &used);
  } catch (const std::exception&) {
    // A number that is missing or too large for a double is reported below.
  }
  if (used != text.size() || !std::isfinite(value)) {
    reject(name + " is '" + text + "', not a finite number");
  }
  return value;
}

double Table::number_or(const std::string& name, double otherwise) const {
  return columns_.count(name) > 0 && !text(name).empty() ? number(name) : otherwise;
}

double Table::std_dev_or(const std::string& name, double otherwise) const {
  const double value = number_or(name, otherwise);
  if (!(value > 0.0)) reject(name + " is a standard deviation, which has to be positive");
  return value;
}

int Table::integer(const std::string& name) const {
  const double value = number(name);
  if (value != std::floor(value) || std::abs(value) > std::numeric_limits<int>::max()) {
    reject(name + " is '" + text(name) + "', not a whole number in range");
  }
  return static_cast<int>(value);
}

void Table::reject(const std::string& what) const {
  fail(path_, "line " + std::to_string(number_) + ": " + what);
}

std::string Table::text(const std::string& name) const {
  const std::size_t column = columns_.at(name);
  return column < cells_.size() ? std::string(cells_[column]) : std::string();
}

}  // namespace plenocal
