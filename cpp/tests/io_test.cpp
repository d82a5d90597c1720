// Files: the shipped data set, which Rust wrote, round trips, and what is wrong in them.
#include "plenocal/io.hpp"

#include <gtest/gtest.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <functional>
#include <regex>

#include "rejection.hpp"
#include "synthetic_scene.hpp"

namespace plenocal {
namespace {

const std::string kData = PLENOCAL_DATA;
// The board and the noise of the set, as data/synthetic was made.
constexpr BoardGrid kBoard{9, 5, 3.0};
constexpr double kNoisePx = 0.2;

class Files : public testing::Test {
 protected:
  void SetUp() override { std::remove(path().c_str()); }
  void TearDown() override { std::remove(path().c_str()); }

  std::string path() const {
    return testing::TempDir() + "plenocal_" +
           testing::UnitTest::GetInstance()->current_test_info()->name();
  }
  std::string write(const std::string& text) const {
    std::ofstream(path()) << text;
    return path();
  }
};

// The message of a FileError, which has to name the file.
std::string failure(const std::string& path, const std::function<void()>& action) {
  try {
    action();
  } catch (const FileError& error) {
    EXPECT_EQ(std::string(error.what()).rfind(path, 0), 0U) << error.what();
    return error.what();
  }
  return "(read)";
}

std::string text_of(const std::string& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

std::string replaced(std::string text, const std::string& what, const std::string& by) {
  const std::size_t at = text.find(what);
  EXPECT_NE(at, std::string::npos) << what;
  return text.replace(at, what.size(), by);
}

CameraFile camera_file(int lens_types) {
  CameraFile file;
  file.camera = test::scene_camera(lens_types);
  file.f_number = 4.0;
  return file;
}

TEST_F(Files, TheShippedObservationsAreThoseOfItsTrueCamera) {
  const CameraFile file = read_camera(kData + "/truth/camera.json");
  const auto poses = read_poses(kData + "/truth/poses.json");
  const ObservationFiles seen =
      read_observations(kData + "/features.csv", kData + "/centers.csv", kBoard);
  EXPECT_GT(file.camera.width, 500);
  EXPECT_FALSE(file.converged);
  EXPECT_EQ(seen.frames.size(), poses.size());
  double square = 0.0;
  for (const FeatureObservation& f : seen.observations.features) {
    const auto projected =
        project(file.camera, poses.at(seen.frames.at(f.frame)), f.board_point, f.k, f.l);
    ASSERT_TRUE(projected);
    square += std::pow(projected->u - f.observed.u, 2) + std::pow(projected->v - f.observed.v, 2);
  }
  const double rms = std::sqrt(square / 2.0 / seen.observations.features.size());
  EXPECT_NEAR(rms, kNoisePx, 0.05 * kNoisePx);
  square = 0.0;
  for (const CenterObservation& c : seen.observations.centers) {
    const Pixel<double> at = project_center(file.camera, c.k, c.l);
    square += std::pow(at.u - c.observed.u, 2) + std::pow(at.v - c.observed.v, 2);
  }
  EXPECT_LT(std::sqrt(square / seen.observations.centers.size()), 1.0);
}

TEST_F(Files, CamerasComeBackExactly) {
  for (int types : {0, 1, 3}) {
    for (Packing packing :
         {Packing::kOrthogonal, Packing::kHexagonalRowsEven, Packing::kHexagonalRowsOdd,
          Packing::kHexagonalColumnsEven, Packing::kHexagonalColumnsOdd}) {
      if (types == 3 && packing == Packing::kOrthogonal) continue;
      CameraFile file = camera_file(types);
      file.camera.lattice.packing = packing;
      file.camera.width = 640;
      file.camera.height = 480;
      file.f_number = 5.656854;
      file.focus_distance = 451.25;
      file.converged = true;
      const auto names = intrinsic_names(types);
      for (std::size_t i = 0; i < names.size(); ++i) {
        file.std_dev.push_back(i % 3 == 1 ? std::nan("") : 0.25 * static_cast<double>(i + 1));
      }
      for (std::size_t i = 0, n = 0; i < names.size(); ++i) n += i % 3 != 1;
      write_camera(path(), file);
      const CameraFile read = read_camera(path());
      EXPECT_EQ(read.camera.lattice.packing, packing);
      EXPECT_EQ(read.camera.height, 480);
      EXPECT_EQ(read.f_number, file.f_number);
      EXPECT_EQ(read.focus_distance, file.focus_distance);
      EXPECT_EQ(read.converged, true);
      std::vector<double> expected, found;
      for_each_parameter(file.camera, [&](const auto&, double x) { expected.push_back(x); });
      for_each_parameter(read.camera, [&](const auto&, double x) { found.push_back(x); });
      EXPECT_EQ(found, expected);
      ASSERT_EQ(read.std_dev.size(), names.size());
      for (std::size_t i = 0; i < names.size(); ++i) {
        EXPECT_TRUE(i % 3 == 1 ? std::isnan(read.std_dev[i]) : read.std_dev[i] == file.std_dev[i]);
      }
      EXPECT_TRUE(read.covariance.values.empty());
    }
  }
}

TEST_F(Files, ThePupilOfOldFilesIsInTheLens) {
  CameraFile file = camera_file(1);
  write_camera(path(), file);
  const std::regex later(R"("(exit_pupil_mm": \[[^\]]*\]|field_curvature_per_mm": [^,]*),)");
  std::string text = std::regex_replace(text_of(path()), later, "");
  text = replaced(text, "\"version\": 2", "\"version\": 1");
  const CameraFile read = read_camera(write(text));
  EXPECT_EQ(read.camera.exit_pupil.z, 0.0);
  EXPECT_EQ(read.camera.main_lens.field_curvature, 0.0);
  EXPECT_TRUE(std::isinf(read.focus_distance));
}

TEST_F(Files, CovariancesComeBack) {
  CameraFile file = camera_file(0);
  const int n = static_cast<int>(intrinsic_names(0).size());
  file.std_dev.assign(n, 2.0);
  file.covariance = {n, n, {}};
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) file.covariance.values.push_back(i == j ? 4.0 : 0.01 * (i + j));
  }
  write_camera(path(), file);
  const CameraFile read = read_camera(path());
  ASSERT_EQ(read.covariance.rows, n);
  EXPECT_LT((read.covariance.eigen() - file.covariance.eigen()).cwiseAbs().maxCoeff(), 1e-15);
}

TEST_F(Files, WhatIsWrongInACameraIsNamed) {
  CameraFile file = camera_file(3);
  write_camera(path(), file);
  const std::string text = text_of(path());
  const auto message = [&](const std::string& what, const std::string& by) {
    write(replaced(text, what, by));
    return failure(path(), [&] { read_camera(path()); });
  };
  using test::expect_names;
  expect_names(message("focal_length_mm\"", "focal_length_cm\""), "main_lens.focal_length_cm");
  expect_names(message("\"columns\": 20", "\"columns\": 20.5"), "micro_lens_array.columns");
  expect_names(message("\"columns\": 20", "\"columns\": 18446744073709551615"), "in range");
  expect_names(message("\"columns\": 20", "\"columns\": \"20\""), "whole number");
  expect_names(message("hexagonal-rows", "triangular"), "micro_lens_array.lattice");
  expect_names(message("\"pixel_size_mm\": 0.0055", "\"pixel_size_mm\": -0.0055"), "pixel size");
  expect_names(message("\"version\": 2", "\"version\": 3"), "version 3");
  expect_names(message("plenocal-camera", "plenocal-poses"), "plenocal-camera");
  expect_names(message("}", ""), "JSON");
  expect_names(failure(path() + "x", [&] { read_camera(path() + "x"); }), "cannot be opened");
  expect_names(message("\"columns\": 20", "\"columns\": 20, \"columns\": 21"), "columns twice");
  expect_names(failure(testing::TempDir(), [&] { read_camera(testing::TempDir()); }), "a folder");
  file.f_number = CameraFile{}.f_number;
  expect_names(test::rejection([&] { write_camera(path(), file); }), "f-number");
  file.camera.pixel_size = 0.0;
  expect_names(test::rejection([&] { write_camera(path(), file); }), "pixel size");
}

// What the Rust side tells of the same files (`camera_findings`).
TEST_F(Files, WhatSpeaksAgainstACameraIsSaid) {
  CameraFile file = camera_file(1);
  write_camera(path(), file);
  EXPECT_TRUE(read_camera(path()).objections().empty());
  EXPECT_FALSE(read_camera(path()).verdict);

  file.converged = true;
  file.verdict = Verdict::kGood;
  write_camera(path(), file);
  EXPECT_EQ(read_camera(path()).verdict, Verdict::kGood);
  EXPECT_TRUE(read_camera(path()).objections().empty());

  file.verdict = Verdict::kDoNotUse;
  file.reasons = {"bad-fit", "unexplained-blur"};
  write_camera(path(), file);
  CameraFile read = read_camera(path());
  EXPECT_EQ(read.verdict, Verdict::kDoNotUse);
  EXPECT_EQ(read.reasons, file.reasons);
  ASSERT_EQ(read.objections().size(), 1U);
  EXPECT_EQ(read.objections()[0],
            "the verdict on the calibration of this camera is \"do not use\" (bad-fit, "
            "unexplained-blur): see its report, and calibrate it again");

  // Where these apply, they are the reasons.
  file.converged = false;
  file.std_dev.assign(intrinsic_names(1).size(), 0.5);
  file.std_dev[0] = file.std_dev[13] = std::nan("");
  file.undetermined = {"F", "d"};
  write_camera(path(), file);
  read = read_camera(path());
  EXPECT_EQ(read.converged, false);
  EXPECT_EQ(read.undetermined, file.undetermined);
  EXPECT_TRUE(std::isnan(read.std_dev[0]));
  ASSERT_EQ(read.objections().size(), 2U);
  test::expect_names(read.objections()[0], "has not converged");
  test::expect_names(read.objections()[1], "has not determined F, d");
}

TEST_F(Files, PosesComeBackExactly) {
  std::map<int, Pose> poses;
  for (const Pose& pose : test::scene_poses()) poses[7 * static_cast<int>(poses.size())] = pose;
  write_poses(path(), poses);
  const auto read = read_poses(path());
  ASSERT_EQ(read.size(), poses.size());
  for (const auto& [frame, pose] : poses) EXPECT_EQ(pose_block(read.at(frame)), pose_block(pose));
  write(replaced(text_of(path()), "\"frame\": 7", "\"frame\": 0"));
  test::expect_names(failure(path(), [&] { read_poses(path()); }), "frame 0 has two poses");
}

TEST_F(Files, WhatIsWrongInATableIsNamedWithItsLine) {
  const auto message = [&](const std::string& text) {
    write(text);
    return failure(path(), [&] { read_observations(path(), "", kBoard); });
  };
  using test::expect_names;
  const std::string header = "k,l,u,v,rho,cluster,frame\n";
  expect_names(message("k,l,u,v,cluster\n1,2,3,4,5\n"), "frame");
  expect_names(message("k,k,l,u,v,cluster,frame\n"), "twice");
  expect_names(message(header), "no observations");
  expect_names(message(header + "1,2,3,4,0.5,0,0\n\n1,2,x,4,0.5,0,0\n"), "line 4: u");
  expect_names(message(header + "1,2,nan,4,0.5,0,0\n"), "line 2: u");
  expect_names(message(header + "1,2,3\n"), "line 2: v");
  expect_names(message(header + "1.5,2,3,4,0.5,0,0\n"), "line 2: k");
  expect_names(message(header + "1,2,3,4,0.5,54,0\n"), "corner 54");
  expect_names(message("k,l,u,v,cluster,frame,std_u\n1,2,3,4,0,0,-1\n"), "std_u");
}

// A small problem as plenocal exports it.
class ProblemFolder : public Files {
 protected:
  void SetUp() override {
    std::filesystem::remove_all(path());
    std::filesystem::create_directory(path());
    CameraFile file = camera_file(1);
    write_camera(at("camera.json"), file);
    write_poses(at("poses.json"), {{3, test::scene_poses().at(0)}});
    put("features.csv", "frame,corner,x,y,z,k,l,u,v,std_u,std_v\n3,0,0,0,0,2,3,100,80,0.1,0.2\n");
    put("centers.csv", "k,l,u,v,std_dev\n2,3,101,81,0.05\n");
    put("problem.json", kProblem);
  }
  void TearDown() override { std::filesystem::remove_all(path()); }

  std::string at(const std::string& name) const { return path() + "/" + name; }
  void put(const std::string& name, const std::string& text) const {
    std::ofstream(at(name)) << text;
  }
  // The message about a file in which something was replaced; the file is then as before.
  std::string message(const std::string& name, const std::string& what, const std::string& by) {
    const std::string before = text_of(at(name));
    put(name, replaced(before, what, by));
    const std::string said = failure(at(name), [&] { read_problem(path()); });
    put(name, before);
    return said;
  }

  static constexpr auto kProblem = R"({"format": "plenocal-problem", "version": 1,
    "board": {"half_width_mm": 12.0, "half_height_mm": 6.0, "sag_x_mm": 0.0, "sag_y_mm": 0.0,
              "twist_mm": 0.0, "aspect": 0.0},
    "rho": false, "loss": {"kind": "huber", "scale": 4.0}, "prior_weight": 2.0,
    "fixed": ["e_x", "e_y"], "priors": [{"quantity": "F", "value": 50.0, "std_dev": 1.5}]})";
};

TEST_F(ProblemFolder, IsReadAsItWasWritten) {
  const ProblemFiles problem = read_problem(path());
  EXPECT_EQ(problem.frames, std::vector<int>{3});
  ASSERT_EQ(problem.observations.features.size(), 1U);
  EXPECT_EQ(problem.observations.features[0].frame, 0);
  EXPECT_EQ(problem.observations.features[0].std_dev.v, 0.2);
  EXPECT_EQ(problem.observations.centers.at(0).std_dev, 0.05);
  EXPECT_EQ(problem.observations.board.half_width, 12.0);
  EXPECT_EQ(problem.options.features_loss.kind, LossKind::kHuber);
  EXPECT_EQ(problem.options.prior_weight, 2.0);
  EXPECT_EQ(problem.options.priors.at(0).quantity, "F");
  EXPECT_FALSE(problem.options.rho);
}

// Before 0.1.0, priors were called anchors, and the tilt gradient lean.
TEST_F(ProblemFolder, OfEarlierVersionsIsRead) {
  std::string text = replaced(kProblem, "prior_weight", "anchor_weight");
  text = replaced(replaced(text, "priors", "anchors"), "\"F\"", "\"lean_v\"");
  put("problem.json", text);
  const ProblemFiles problem = read_problem(path());
  EXPECT_EQ(problem.options.prior_weight, 2.0);
  EXPECT_EQ(problem.options.priors.at(0).quantity, "tilt_v");
}

TEST_F(ProblemFolder, WhatIsWrongIsNamedWithItsFile) {
  using test::expect_names;
  expect_names(message("problem.json", "plenocal-problem", "plenocal-camera"), "plenocal-problem");
  expect_names(message("problem.json", "\"version\": 1", "\"version\": 2"), "newer plenocal");
  expect_names(message("problem.json", "half_width_mm", "half_width"), "board.half_width_mm");
  expect_names(message("problem.json", "huber", "tukey"), "none, huber or cauchy");
  expect_names(message("problem.json", "4.0}", "\"four\"}"), "loss.scale");
  expect_names(message("problem.json", "1.5", "null"), "priors[0].std_dev");
  expect_names(message("problem.json", "\"e_y\"", "7"), "fixed[1]");
  expect_names(message("problem.json", "false", "0"), "rho");
  expect_names(message("problem.json", "}]}", ""), "JSON");
  expect_names(message("poses.json", "\"frame\": 3", "\"frame\": \"3\""), "frame");
  expect_names(message("camera.json", "plenocal-camera", "camera"), "plenocal-camera");
  expect_names(message("features.csv", "3,0,0,0,0,2", "4,0,0,0,0,2"), "line 2: frame 4");
  expect_names(message("features.csv", "0.2", "0"), "std_v");
  expect_names(message("features.csv", "x,", "X,"), "no column x");
  expect_names(message("centers.csv", "101", "inf"), "line 2: u");
  for (const char* name :
       {"problem.json", "camera.json", "poses.json", "features.csv", "centers.csv"}) {
    std::filesystem::rename(at(name), at("away"));
    expect_names(failure(at(name), [&] { read_problem(path()); }), "cannot be opened");
    std::filesystem::rename(at("away"), at(name));
  }
  EXPECT_EQ(read_problem(path()).frames.size(), 1U);
}

TEST_F(ProblemFolder, FramesAreThoseOfAnotherCamera) {
  const ProblemFiles problem = read_problem(path());
  ASSERT_EQ(problem.observations.features.size(), 1U);
  const Observations seen = problem.with_frames({1, 2, 3});
  ASSERT_EQ(seen.features.size(), 1U);
  EXPECT_EQ(seen.features.at(0).frame, 2);
  EXPECT_EQ(seen.centers.size(), 1U);
  EXPECT_TRUE(problem.with_frames({1, 2}).features.empty());
}

}  // namespace
}  // namespace plenocal
