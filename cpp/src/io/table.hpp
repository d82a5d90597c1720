// CSV tables.
#pragma once

#include <map>
#include <sstream>
#include <string>
#include <string_view>
#include <vector>

namespace plenocal {

/// CSV file with the names of its columns in the first line. An error in it gives a FileError with
/// the line.
class Table {
 public:
  Table(const std::string& path, const std::vector<std::string>& required);

  /// Goes to the next line that is not empty; returns false if there is none.
  bool next();

  double number(const std::string& name) const;
  /// Reads a number, or returns `otherwise` if the column is missing or the cell empty.
  double number_or(const std::string& name, double otherwise) const;
  /// Reads a standard deviation in the same way.
  double std_dev_or(const std::string& name, double otherwise) const;
  int integer(const std::string& name) const;

  /// Throws a FileError about this line.
  [[noreturn]] void reject(const std::string& what) const;

 private:
  void split();
  std::string text(const std::string& name) const;

  std::string path_;
  std::istringstream lines_;
  std::string line_;
  int number_ = 0;  // number of the line, from 1
  std::vector<std::string_view> cells_;
  std::map<std::string, std::size_t> columns_;
};

}  // namespace plenocal
