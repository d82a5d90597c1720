// Files: cameras, poses, observations and whole problems, as plenocal writes them (docs/files.md).
// The library plenocal::io, which needs nlohmann-json; the rest of plenocal does not need files.
#pragma once

#include <limits>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "plenocal/refine.hpp"

namespace plenocal {

/// A file that cannot be read or written. The message names the file, and the field or the line.
class PLENOCAL_API FileError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// The verdict on a calibration: the heaviest of what speaks against it.
enum class Verdict { kGood, kUsableWithCare, kDoNotUse };

/// The content of camera.json, without the distances of the boards, the aperture ratio and the
/// point spread.
struct CameraFile {
  Camera camera;
  /// Setting of the main lens: N of the images of boards, which a camera that is written has to
  /// state, and the focus distance from the sensor, mm, infinite for infinity.
  double f_number = std::numeric_limits<double>::quiet_NaN();
  double focus_distance = std::numeric_limits<double>::infinity();
  /// Whether the camera is at a minimum; nothing if it is no result of a calibration.
  std::optional<bool> converged;
  /// The verdict on the calibration, and the codes of its reasons ("bad-fit"); nothing if the file
  /// states none.
  std::optional<Verdict> verdict;
  std::vector<std::string> reasons;
  /// Names of the parameters that the calibration has not determined.
  std::vector<std::string> undetermined;
  /// sigma of each parameter in the order of `for_each_parameter`, in its unit; not a number where
  /// it was fixed or not determined. Empty if none is known.
  std::vector<double> std_dev;
  /// Covariance of the parameters with a sigma, in their order; empty if it is not known.
  Matrix covariance;

  /// Reasons against using the camera, one sentence each: its calibration has not converged, has
  /// not determined some parameters, or ended in the verdict "do not use". The command line prints
  /// the same warnings. Empty if there is no reason, or if nothing is known of a calibration.
  PLENOCAL_API std::vector<std::string> objections() const;
};

/// Reads a camera. Throws FileError if the file cannot be read, is none of these, lacks a field or
/// has one that is not known, or has a camera that is not valid.
PLENOCAL_API CameraFile read_camera(const std::string& path);

/// Writes a camera so that plenocal reads it; what else a file said is not written again, since it
/// belongs to the camera as it was calibrated. Throws FileError, and std::invalid_argument if the
/// camera is not valid, its f-number is not stated, or sigma and covariance are not of its
/// parameters.
PLENOCAL_API void write_camera(const std::string& path, const CameraFile& file);

/// Reads camera_from_board of each frame. Throws FileError.
PLENOCAL_API std::map<int, Pose> read_poses(const std::string& path);

/// Writes camera_from_board of each frame. Throws FileError.
PLENOCAL_API void write_poses(const std::string& path, const std::map<int, Pose>& poses);

/// Corners of a board: inner corners along its rows and columns, and the edge of a square.
struct BoardGrid {
  int columns = 0, rows = 0;
  double square = 0.0;  ///< mm

  /// Corner number i of the flat board, row by row; mm, board frame. Throws std::invalid_argument
  /// for a corner that the board does not have.
  Vector3<double> corner(int i) const {
    if (i < 0 || columns < 1 || i / columns >= rows) {
      throw std::invalid_argument("corner " + std::to_string(i) + " is not on a board of " +
                                  std::to_string(columns) + " x " + std::to_string(rows));
    }
    return {square * (i % columns), square * (i / columns), 0.0};
  }
  /// The board, flat.
  Board board() const { return {0.5 * square * (columns - 1), 0.5 * square * (rows - 1), {}}; }
};

/// Observations and what they belong to.
struct ObservationFiles {
  /// `FeatureObservation::frame` is an index into `frames`.
  Observations observations;
  std::vector<int> frames;   ///< numbers of the frames, ascending
  std::vector<int> corners;  ///< number of the corner of each feature
};

/// Reads features.csv, and centers.csv unless its path is empty. Features that state no sigma have
/// 1 px. Throws FileError, with the line, where a number is missing, is not finite, or is not on
/// the board.
PLENOCAL_API ObservationFiles read_observations(const std::string& features,
                                                const std::string& centers, const BoardGrid& board);

/// A whole problem: what `plenocal calibrate --export-problem DIR` writes.
struct ProblemFiles {
  CameraFile start;
  std::vector<int> frames;  ///< numbers of the frames
  std::vector<Pose> poses;  ///< where they start
  Observations observations;
  CostOptions options;

  /// The observations for the poses of another camera that has these frames, as a rig needs them:
  /// `FeatureObservation::frame` becomes an index into `of_other`, and features of frames that the
  /// other one does not have are left out.
  PLENOCAL_API Observations with_frames(const std::vector<int>& of_other) const;
};

/// Reads a problem from its folder. Throws FileError.
PLENOCAL_API ProblemFiles read_problem(const std::string& folder);

}  // namespace plenocal
