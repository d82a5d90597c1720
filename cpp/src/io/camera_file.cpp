// camera.json.
#include <cmath>
#include <map>

#include "document.hpp"

namespace plenocal {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr int kVersion = 2;

struct NamedPacking {
  Packing packing;
  const char* lattice;
  const char* shifted;
};
constexpr NamedPacking kPackings[] = {{Packing::kOrthogonal, "orthogonal", ""},
                                      {Packing::kHexagonalRowsEven, "hexagonal-rows", "even"},
                                      {Packing::kHexagonalRowsOdd, "hexagonal-rows", "odd"},
                                      {Packing::kHexagonalColumnsEven, "hexagonal-columns", "even"},
                                      {Packing::kHexagonalColumnsOdd, "hexagonal-columns", "odd"}};

Lattice lattice_from(const Field& array) {
  const std::string lattice = array["lattice"].string();
  const std::string shifted = lattice == "orthogonal" ? "" : array["shifted"].string();
  for (const NamedPacking& named : kPackings) {
    if (lattice == named.lattice && shifted == named.shifted) {
      return {named.packing, array["columns"].integer(), array["rows"].integer()};
    }
  }
  array["lattice"].reject(
      "orthogonal, or hexagonal-rows or hexagonal-columns with shifted even or odd");
}

// Adds what files of version 1 do not have: exit pupil and field curvature, which are 0 there.
void complete(Json* json) {
  const auto lens = json->find("main_lens");
  if (lens == json->end() || !lens->is_object()) return;
  const auto add = [&lens](const char* key, const Json& value) {
    if (!lens->contains(key) || (*lens)[key].is_null()) (*lens)[key] = value;
  };
  add("exit_pupil_mm", {0.0, 0.0, 0.0});
  add("field_curvature_per_mm", 0.0);
  add("field_curvature_growth_per_mm", 0.0);
}

Camera camera_from(const Field& root) {
  const Field sensor = root["sensor"], lens = root["main_lens"], array = root["micro_lens_array"];
  Camera camera;
  camera.lattice = lattice_from(array);
  camera.pixel_size = sensor["pixel_size_mm"].number();
  camera.width = sensor["width_px"].integer();
  camera.height = sensor["height_px"].integer();
  lens["exit_pupil_mm"].vector();
  array["rotation_rad"].vector();
  const std::size_t types = array["focal_lengths_mm"].size();
  if (types > kMaxLensTypes) array["focal_lengths_mm"].reject("a list of at most 3 numbers");
  camera.micro_lens_focal_lengths.resize(types);
  const Parameter* parameter = kParameters;
  for_each_parameter(camera, [&](const std::string&, double& value) {
    value = root.at_pointer((parameter++)->key).number();
  });
  try {
    validate(camera);
  } catch (const std::invalid_argument& error) {
    fail(root.file(), error.what());
  }
  return camera;
}

// sigma of all parameters, and the covariance of those that have one.
void read_uncertainty(const Field& uncertainty, CameraFile* file) {
  const std::vector<std::string> names = intrinsic_names(file->camera.lens_types());
  const Field std_devs = uncertainty["standard_deviations"];
  std::map<std::string, double> known;
  for (const std::string& name : names) {
    const bool has = std_devs.has(name) && std_devs[name].has("value");
    file->std_dev.push_back(has ? std_devs[name]["value"].number() : kNan);
    if (has) known[name] = file->std_dev.back();
  }
  if (!uncertainty.has("correlations")) return;
  const Field correlations = uncertainty["correlations"];
  const Field free = correlations["parameters"], matrix = correlations["matrix"];
  std::map<std::string, std::size_t> row;
  for (std::size_t i = 0; i < free.size(); ++i) row[free.at(i).string()] = i;
  std::vector<double> covariance;
  for (const std::string& a : names) {
    for (const std::string& b : names) {
      if (known.count(a) == 0 || known.count(b) == 0) continue;
      if (row.count(a) == 0 || row.count(b) == 0) return;
      const Field entry = matrix.at(row[a]).at(row[b]);
      // Not determined together: no covariance.
      if (entry.is_null()) return;
      covariance.push_back(entry.number() * known[a] * known[b]);
    }
  }
  const int size = static_cast<int>(known.size());
  file->covariance = {size, size, std::move(covariance)};
}

Json camera_json(const CameraFile& file) {
  const Camera& camera = file.camera;
  const auto* packing = &kPackings[0];
  for (const NamedPacking& named : kPackings) {
    if (named.packing == camera.lattice.packing) packing = &named;
  }
  Json json = {{"format", "plenocal-camera"},
               {"version", kVersion},
               {"sensor",
                {{"width_px", camera.width},
                 {"height_px", camera.height},
                 {"pixel_size_mm", camera.pixel_size}}},
               {"main_lens", {{"f_number", file.f_number}}},
               {"micro_lens_array",
                {{"lattice", packing->lattice},
                 {"columns", camera.lattice.columns},
                 {"rows", camera.lattice.rows},
                 {"focal_lengths_mm", Json::array()}}}};
  const Parameter* parameter = kParameters;
  for_each_parameter(camera, [&](const std::string&, double value) {
    json[Json::json_pointer((parameter++)->key)] = value;
  });
  if (std::isfinite(file.focus_distance)) {
    json["main_lens"]["focus_distance_mm"] = file.focus_distance;
  }
  if (*packing->shifted != '\0') json["micro_lens_array"]["shifted"] = packing->shifted;
  if (file.converged) json["converged"] = *file.converged;
  return json;
}

Json uncertainty_json(const CameraFile& file) {
  const std::vector<std::string> names = intrinsic_names(file.camera.lens_types());
  Json std_devs = Json::object();
  std::vector<std::string> free;
  std::vector<double> known;
  for (std::size_t i = 0; i < names.size() && i < file.std_dev.size(); ++i) {
    if (std::isnan(file.std_dev[i])) continue;
    std_devs[names[i]] = {{"value", file.std_dev[i]}, {"unit", kParameters[i].unit}};
    free.push_back(names[i]);
    known.push_back(file.std_dev[i]);
  }
  Json json = {{"standard_deviations", std_devs}};
  const int n = static_cast<int>(free.size());
  if (file.covariance.rows == n) {
    Json matrix = Json::array();
    for (int i = 0; i < n; ++i) {
      Json row = Json::array();
      for (int j = 0; j < n; ++j) {
        row.push_back(file.covariance(i, j) / (known[i] * known[j]));
      }
      matrix.push_back(row);
    }
    json["correlations"] = {{"parameters", free}, {"matrix", matrix}};
  }
  return json;
}

}  // namespace

CameraFile read_camera(const std::string& path) {
  Json json = document(path, "plenocal-camera", kVersion);
  complete(&json);
  const Field root(json, path, "");
  CameraFile file;
  file.camera = camera_from(root);
  const Field lens = root["main_lens"];
  file.f_number = lens["f_number"].number();
  if (lens.has("focus_distance_mm")) file.focus_distance = lens["focus_distance_mm"].number();
  if (root.has("converged")) file.converged = root["converged"].boolean();
  if (root.has("uncertainty")) read_uncertainty(root["uncertainty"], &file);
  return file;
}

void write_camera(const std::string& path, const CameraFile& file) {
  validate(file.camera);
  if (!(std::isfinite(file.f_number) && file.f_number > 0.0)) {
    throw std::invalid_argument("the f-number of the camera has to be positive and finite");
  }
  Json json = camera_json(file);
  if (!file.std_dev.empty()) json["uncertainty"] = uncertainty_json(file);
  write_text(path, json.dump(2) + "\n");
}

}  // namespace plenocal
