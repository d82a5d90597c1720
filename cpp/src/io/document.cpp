#include "document.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <limits>
#include <set>
#include <vector>

namespace plenocal {

void fail(const std::string& path, const std::string& what) { throw FileError(path + ": " + what); }

std::string text_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) fail(path, "cannot be opened: check that it exists and is readable");
  try {
    std::string text{std::istreambuf_iterator<char>(file), {}};
    if (file.bad()) fail(path, "cannot be read");
    return text;
  } catch (const std::ios_base::failure&) {
    fail(path, "cannot be read: give a file, not a folder");
  }
}

void write_text(const std::string& path, const std::string& text) {
  const std::string beside = path + ".part";
  {
    std::ofstream file(beside, std::ios::binary);
    file << text;
    file.close();
    if (!file) {
      std::remove(beside.c_str());
      fail(path, "cannot be written: check the folder and the free space on the disk");
    }
  }
  if (std::rename(beside.c_str(), path.c_str()) != 0) {
    std::remove(beside.c_str());
    fail(path, "cannot be written: check that it may be replaced");
  }
}

bool Field::has(const std::string& key) const {
  return value_.is_object() && value_.contains(key) && !value_[key].is_null();
}

std::vector<std::string> Field::keys() const {
  if (!value_.is_object()) reject("a table of fields");
  std::vector<std::string> keys;
  for (const auto& [key, value] : value_.items()) keys.push_back(key);
  return keys;
}

void Field::require_keys(std::initializer_list<const char*> known) const {
  for (const std::string& key : keys()) {
    if (std::find(known.begin(), known.end(), key) == known.end()) {
      fail(path_, "has the unknown field " + name_of(key) + ": check its spelling");
    }
  }
}

std::string Field::name_of(const std::string& key) const {
  return name_.empty() ? key : name_ + "." + key;
}

Field Field::operator[](const std::string& key) const {
  const std::string name = name_of(key);
  if (!value_.is_object() || !value_.contains(key)) fail(path_, "there is no " + name);
  return {value_[key], path_, name};
}

Field Field::at(std::size_t i) const {
  const std::string name = name_ + "[" + std::to_string(i) + "]";
  if (i >= size()) fail(path_, "there is no " + name);
  return {value_[i], path_, name};
}

Field Field::at_pointer(const std::string& pointer) const {
  if (pointer.empty()) return *this;
  const std::size_t end = std::min(pointer.find('/', 1), pointer.size());
  const std::string token = pointer.substr(1, end - 1);
  const bool is_index = std::isdigit(static_cast<unsigned char>(token[0])) != 0;
  return (is_index ? at(std::stoul(token)) : (*this)[token]).at_pointer(pointer.substr(end));
}

std::size_t Field::size() const {
  if (!value_.is_array()) reject("a list");
  return value_.size();
}

double Field::number() const {
  if (!value_.is_number()) reject("a number");
  const double number = value_.get<double>();
  if (!std::isfinite(number)) reject("a finite number");
  return number;
}

int Field::integer() const {
  using Limits = std::numeric_limits<int>;
  const bool whole = value_.is_number_integer();
  // An unsigned number beyond the range of signed ones would wrap around.
  if (!whole || number() < Limits::min() || number() > Limits::max()) {
    reject("a whole number in range");
  }
  return value_.get<int>();
}

bool Field::boolean() const {
  if (!value_.is_boolean()) reject("true or false");
  return value_.get<bool>();
}

std::string Field::string() const {
  if (!value_.is_string()) reject("a text");
  return value_.get<std::string>();
}

Vector3<double> Field::vector() const {
  if (size() != 3) reject("a list of 3 numbers");
  return {at(0).number(), at(1).number(), at(2).number()};
}

void Field::reject(const std::string& wanted) const { fail(path_, name_ + " is not " + wanted); }

Json document(const std::string& path, const std::string& format, int latest) {
  Json json;
  // JSON does not define which of two values with one key counts.
  std::vector<std::set<std::string>> keys;
  const auto check = [&](int, Json::parse_event_t event, Json& parsed) {
    if (event == Json::parse_event_t::object_start) keys.emplace_back();
    if (event == Json::parse_event_t::object_end) keys.pop_back();
    if (event == Json::parse_event_t::key &&
        !keys.back().insert(parsed.get<std::string>()).second) {
      fail(path, "has the field " + parsed.get<std::string>() + " twice");
    }
    return true;
  };
  try {
    json = Json::parse(text_of(path), check);
  } catch (const Json::exception& error) {
    fail(path, std::string("is not JSON: ") + error.what());
  }
  const Field root(json, path, "");
  if (!root.has("format") || root["format"].string() != format) {
    fail(path, "is not a " + format + " file");
  }
  const int version = root["version"].integer();
  if (version < 1 || version > latest) {
    fail(path, "has version " + std::to_string(version) + ", but only versions up to " +
                   std::to_string(latest) + " are known: use a newer plenocal");
  }
  return json;
}

}  // namespace plenocal
