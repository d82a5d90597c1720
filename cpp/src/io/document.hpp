// JSON documents: fields with their names for messages.
#pragma once

#include <initializer_list>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "plenocal/io.hpp"

namespace plenocal {

using Json = nlohmann::json;

/// Throws FileError.
[[noreturn]] void fail(const std::string& path, const std::string& what);

/// Returns the content of a file.
std::string text_of(const std::string& path);

/// Writes a temporary file next to the target and renames it, so that no incomplete file remains.
void write_text(const std::string& path, const std::string& text);

/// Value in a document. A missing field or one of another type gives a FileError with its name.
class Field {
 public:
  /// Creates a field, which keeps references to the document and the path.
  Field(const Json& value, const std::string& path, std::string name)
      : value_(value), path_(path), name_(std::move(name)) {}

  /// Returns true if there is a field of this name that is not null.
  bool has(const std::string& key) const;
  /// Returns the names of the fields of a table.
  std::vector<std::string> keys() const;
  /// Rejects a table that has a field of another name: a misspelt one would be ignored.
  void require_keys(std::initializer_list<const char*> known) const;
  Field operator[](const std::string& key) const;
  Field at(std::size_t i) const;
  std::size_t size() const;
  /// Returns the value at a JSON pointer.
  Field at_pointer(const std::string& pointer) const;

  bool is_null() const { return value_.is_null(); }
  double number() const;
  int integer() const;
  bool boolean() const;
  std::string string() const;
  Vector3<double> vector() const;

  [[noreturn]] void reject(const std::string& wanted) const;
  const std::string& file() const { return path_; }

 private:
  std::string name_of(const std::string& key) const;

  const Json& value_;
  const std::string& path_;
  std::string name_;
};

/// Reads a document of a format and of one of the versions up to `latest`.
Json document(const std::string& path, const std::string& format, int latest);

}  // namespace plenocal
