// camera.json.
#include <algorithm>
#include <cmath>
#include <map>

#include "document.hpp"

namespace plenocal {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr int kVersion = 2;
constexpr double kTurn = 6.283185307179586;  // 2 pi

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

struct NamedVerdict {
  Verdict verdict;
  const char* name;
};
constexpr NamedVerdict kVerdicts[] = {{Verdict::kGood, "good"},
                                      {Verdict::kUsableWithCare, "usable with care"},
                                      {Verdict::kDoNotUse, "do not use"}};

// Earlier names of fields are known too.
void require_known_fields(const Field& root) {
  root.require_keys({"format", "version", "converged", "verdict", "boards", "sensor", "main_lens",
                     "principal_point_px", "micro_lens_array", "point_spread_px2", "point_spread",
                     "depth_from_blur", "uncertainty"});
  root["sensor"].require_keys({"width_px", "height_px", "pixel_size_mm"});
  root["main_lens"].require_keys({"focal_length_mm", "q1_per_mm2", "q2_per_mm4", "q3_per_mm6",
                                  "q1_growth_per_mm2", "p1_per_mm", "p2_per_mm",
                                  "field_curvature_per_mm", "field_curvature_growth_per_mm",
                                  "rotation_rad", "exit_pupil_mm", "pupil_aberration_per_mm",
                                  "f_number", "focus_distance_mm"});
  root["micro_lens_array"].require_keys({"lattice", "columns", "rows", "shifted", "lens_to_mla_mm",
                                         "mla_to_sensor_mm", "rotation_rad", "offset_mm",
                                         "pitch_mm", "pitch_ratio", "focal_lengths_mm",
                                         "aperture_ratio", "fill_factor", "opening"});
}

void require_distances(const Field& boards) {
  if (!boards.has("near_mm") || !boards.has("far_mm")) return;
  if (boards["near_mm"].number() > boards["far_mm"].number()) {
    boards["near_mm"].reject("at most boards.far_mm");
  }
}

// Adds fields that older files do not have, which are 0 there: exit pupil, its aberration, field
// curvature, the growth of distortion, and the rotation of the lens.
void complete(Json* json) {
  const auto lens = json->find("main_lens");
  if (lens == json->end() || !lens->is_object()) return;
  const auto add = [&lens](const char* key, const Json& value) {
    if (!lens->contains(key) || (*lens)[key].is_null()) (*lens)[key] = value;
  };
  add("rotation_rad", {0.0, 0.0});
  add("exit_pupil_mm", {0.0, 0.0, 0.0});
  add("pupil_aberration_per_mm", 0.0);
  add("q1_growth_per_mm2", 0.0);
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
  if (lens["rotation_rad"].size() != 2) lens["rotation_rad"].reject("two angles in rad");
  const Vector3<double> angles = array["rotation_rad"].vector();
  if (std::max({std::abs(angles.x), std::abs(angles.y), std::abs(angles.z)}) > kTurn) {
    array["rotation_rad"].reject("angles in rad, at most 2 pi each");
  }
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

constexpr double kRounding = 1e-9;  // tolerance of correlations

// Reads sigma of all parameters, and the covariance of the parameters that have one.
void read_uncertainty(const Field& uncertainty, CameraFile* file) {
  const std::vector<std::string> names = intrinsic_names(file->camera.lens_types());
  const Field std_devs = uncertainty["standard_deviations"];
  const std::vector<std::string> stated = std_devs.keys();
  std::map<std::string, double> known;
  for (const std::string& name : names) {
    file->std_dev.push_back(kNan);
    if (std::find(stated.begin(), stated.end(), name) == stated.end()) continue;
    const Field value = std_devs[name]["value"];
    if (value.is_null()) {
      file->undetermined.push_back(name);
      continue;
    }
    if (value.number() < 0.0) value.reject("a standard deviation");
    known[name] = file->std_dev.back() = value.number();
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
      // Parameters that are not determined together have no covariance.
      if (entry.is_null()) return;
      if (std::abs(entry.number()) > 1.0 + kRounding) entry.reject("a correlation");
      covariance.push_back(entry.number() * known[a] * known[b]);
    }
  }
  const int size = static_cast<int>(known.size());
  file->covariance = {size, size, std::move(covariance)};
}

void read_verdict(const Field& field, CameraFile* file) {
  const std::string name = field["verdict"].string();
  for (const NamedVerdict& named : kVerdicts) {
    if (name == named.name) file->verdict = named.verdict;
  }
  if (!file->verdict) field["verdict"].reject("good, usable with care or do not use");
  const Field reasons = field["reasons"];
  for (std::size_t i = 0; i < reasons.size(); ++i) file->reasons.push_back(reasons.at(i).string());
}

std::string joined(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
  return text;
}

// Checks that sigma and covariance fit the parameters.
void require_uncertainty(const CameraFile& file) {
  const std::size_t parameters = intrinsic_names(file.camera.lens_types()).size();
  const auto& std_dev = file.std_dev;
  if (!std_dev.empty() && std_dev.size() != parameters) {
    throw std::invalid_argument("the camera has " + std::to_string(parameters) +
                                " parameters, but " + std::to_string(std_dev.size()) +
                                " standard deviations");
  }
  for (double value : std_dev) {
    if (value < 0.0 || std::isinf(value)) {
      throw std::invalid_argument("a standard deviation of the camera is " + std::to_string(value));
    }
  }
  const auto known = std::count_if(std_dev.begin(), std_dev.end(),
                                   [](double value) { return !std::isnan(value); });
  const Matrix& covariance = file.covariance;
  if (covariance.rows == 0 && covariance.columns == 0 && covariance.values.empty()) return;
  if (covariance.rows != known || covariance.columns != known ||
      covariance.values.size() != static_cast<std::size_t>(known * known)) {
    throw std::invalid_argument("the covariance of the camera is " +
                                std::to_string(covariance.rows) + " x " +
                                std::to_string(covariance.columns) + ", but " +
                                std::to_string(known) + " parameters have a standard deviation");
  }
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
  for (const NamedVerdict& named : kVerdicts) {
    if (file.verdict == named.verdict) {
      json["verdict"] = {{"verdict", named.name}, {"reasons", file.reasons}};
    }
  }
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
  const auto undetermined = [&](const std::string& name) {
    const auto& all = file.undetermined;
    return std::find(all.begin(), all.end(), name) != all.end();
  };
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (undetermined(names[i])) {
      std_devs[names[i]] = {{"value", nullptr}, {"unit", kParameters[i].unit}};
    }
  }
  Json json = {{"standard_deviations", std_devs}};
  const int n = static_cast<int>(free.size());
  if (file.covariance.rows > 0) {
    Json matrix = Json::array();
    for (int i = 0; i < n; ++i) {
      Json row = Json::array();
      for (int j = 0; j < n; ++j) {
        // An exact parameter has no correlation with others.
        const double scale = known[i] * known[j];
        row.push_back(scale > 0.0 ? file.covariance(i, j) / scale : (i == j ? 1.0 : 0.0));
      }
      matrix.push_back(row);
    }
    json["correlations"] = {{"parameters", free}, {"matrix", matrix}};
  }
  return json;
}

}  // namespace

std::vector<std::string> CameraFile::objections() const {
  std::vector<std::string> objections;
  if (converged == false) {
    objections.emplace_back("the calibration of this camera has not converged: calibrate it again");
  }
  if (!undetermined.empty()) {
    objections.push_back("the calibration of this camera has not determined " +
                         joined(undetermined) +
                         ": calibrate it again with frames at other distances and tilts");
  }
  // Otherwise the reasons of the verdict are already listed.
  if (objections.empty() && verdict == Verdict::kDoNotUse) {
    objections.push_back("the verdict on the calibration of this camera is \"do not use\" (" +
                         joined(reasons) + "): see its report, and calibrate it again");
  }
  return objections;
}

CameraFile read_camera(const std::string& path) {
  Json json = document(path, "plenocal-camera", kVersion);
  complete(&json);
  const Field root(json, path, "");
  require_known_fields(root);
  CameraFile file;
  file.camera = camera_from(root);
  const Field lens = root["main_lens"];
  const auto positive = [&lens](const char* key) {
    if (!(lens[key].number() > 0.0)) lens[key].reject("a positive number");
    return lens[key].number();
  };
  if (lens.has("f_number")) file.f_number = positive("f_number");
  if (lens.has("focus_distance_mm")) file.focus_distance = positive("focus_distance_mm");
  if (root.has("converged")) file.converged = root["converged"].boolean();
  if (root.has("verdict")) read_verdict(root["verdict"], &file);
  if (root.has("boards")) require_distances(root["boards"]);
  if (root.has("uncertainty")) read_uncertainty(root["uncertainty"], &file);
  return file;
}

void write_camera(const std::string& path, const CameraFile& file) {
  validate(file.camera);
  if (!(std::isfinite(file.f_number) && file.f_number > 0.0)) {
    throw std::invalid_argument("the f-number of the camera has to be positive and finite");
  }
  require_uncertainty(file);
  Json json = camera_json(file);
  if (!file.std_dev.empty()) json["uncertainty"] = uncertainty_json(file);
  write_text(path, json.dump(2) + "\n");
}

}  // namespace plenocal
