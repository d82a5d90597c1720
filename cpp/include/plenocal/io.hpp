// Files of plenocal: cameras, poses, observations and complete problems (docs/files.md). The
// library plenocal::io needs nlohmann-json; the rest of plenocal does not need files.
#pragma once

#include <limits>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "plenocal/refine.hpp"

namespace plenocal {

/// Error for a file that cannot be read or written. The message names the file, and the field or
/// the line.
class PLENOCAL_API FileError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Verdict on a calibration, from its most severe finding.
enum class Verdict { kGood, kUsableWithCare, kDoNotUse };

/// Content of camera.json, without the distances of the boards, the aperture ratio and the point
/// spread.
struct CameraFile {
  Camera camera;
  /// Setting of the main lens: f-number of the images of boards, required for writing a camera, and
  /// the focus distance from the sensor, mm, infinite for infinity.
  double f_number = std::numeric_limits<double>::quiet_NaN();
  double focus_distance = std::numeric_limits<double>::infinity();
  /// True if the camera is at a minimum; nothing if it is no result of a calibration.
  std::optional<bool> converged;
  /// Verdict on the calibration, and the codes of its reasons ("bad-fit"); nothing if the file
  /// states none.
  std::optional<Verdict> verdict;
  std::vector<std::string> reasons;
  /// Names of the parameters that the calibration has not determined.
  std::vector<std::string> undetermined;
  /// sigma of each parameter in the order of `for_each_parameter`, in its unit; NaN if it was fixed
  /// or not determined. Empty if none is known.
  std::vector<double> std_dev;
  /// Covariance of the parameters with a sigma, in their order; empty if it is not known.
  Matrix covariance;

  /// Returns reasons against using the camera, one sentence each: its calibration has not
  /// converged, has not determined some parameters, or ended in the verdict "do not use". The
  /// command line prints the same warnings. Empty without such reasons, or without information
  /// about a calibration.
  PLENOCAL_API std::vector<std::string> objections() const;
};

/// Reads a camera. Throws FileError if the file cannot be read, has another format, lacks a field
/// or has an unknown one, or if its camera is not valid.
PLENOCAL_API CameraFile read_camera(const std::string& path);

/// Writes a camera so that plenocal reads it. Other fields of the file from which it was read are
/// not written, since they belong to the camera as calibrated. Throws FileError, and
/// std::invalid_argument if the camera is not valid, if its f-number is not stated, or if sigma and
/// covariance do not fit its parameters.
PLENOCAL_API void write_camera(const std::string& path, const CameraFile& file);

/// Reads camera_from_board of each frame. Throws FileError.
PLENOCAL_API std::map<int, Pose> read_poses(const std::string& path);

/// Writes camera_from_board of each frame. Throws FileError.
PLENOCAL_API void write_poses(const std::string& path, const std::map<int, Pose>& poses);

/// Corners of a board: inner corners along its rows and columns, and the edge of a square.
struct BoardGrid {
  int columns = 0, rows = 0;
  double square = 0.0;  ///< mm

  /// Returns corner number i of the flat board, row by row; mm, board frame. Throws
  /// std::invalid_argument for a corner that the board does not have.
  Vector3<double> corner(int i) const {
    if (i < 0 || columns < 1 || i / columns >= rows) {
      throw std::invalid_argument("corner " + std::to_string(i) + " is not on a board of " +
                                  std::to_string(columns) + " x " + std::to_string(rows));
    }
    return {square * (i % columns), square * (i / columns), 0.0};
  }
  /// Returns the board, flat.
  Board board() const { return {0.5 * square * (columns - 1), 0.5 * square * (rows - 1), {}}; }
};

/// Observations with the numbers of their frames and corners.
struct ObservationFiles {
  /// `FeatureObservation::frame` is an index into `frames`.
  Observations observations;
  std::vector<int> frames;   ///< numbers of the frames, ascending
  std::vector<int> corners;  ///< number of the corner of each feature
};

/// Reads features.csv, and centers.csv unless its path is empty. Features without a stated sigma
/// have 1 px. Throws FileError, with the line, if a number is missing, is not finite, or is not on
/// the board.
PLENOCAL_API ObservationFiles read_observations(const std::string& features,
                                                const std::string& centers, const BoardGrid& board);

/// Complete problem, as written by `plenocal calibrate --export-problem DIR`.
struct ProblemFiles {
  CameraFile start;
  std::vector<int> frames;  ///< numbers of the frames
  std::vector<Pose> poses;  ///< initial poses
  Observations observations;
  CostOptions options;

  /// Returns the observations for the poses of another camera with these frames, as needed for a
  /// rig: `FeatureObservation::frame` becomes an index into `of_other`. Features of frames that the
  /// other camera does not have are left out.
  PLENOCAL_API Observations with_frames(const std::vector<int>& of_other) const;
};

/// Reads a problem from its folder. Throws FileError.
PLENOCAL_API ProblemFiles read_problem(const std::string& folder);

}  // namespace plenocal
